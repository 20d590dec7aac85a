"""Events: outages, limits and prices that operators, feeds and OpenADR announce."""
