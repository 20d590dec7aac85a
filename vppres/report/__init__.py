"""One run told to a reader: figures, findings, pages."""
