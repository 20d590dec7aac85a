"""Files of strangers: what is read of them, and where."""
