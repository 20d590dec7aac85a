"""The controller behind a plant of one's own."""
