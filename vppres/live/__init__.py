"""The controller behind your own plant."""
