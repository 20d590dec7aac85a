"""Series of others: their times, their files, their gaps."""
