"""What is announced: outages, limits and prices, of operators, feeds and OpenADR."""
