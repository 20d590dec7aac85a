"""What several test modules share: small days, made-up runs, set-points, an independent check."""
