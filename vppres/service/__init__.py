"""A controller that runs day and night, behind HTTP."""
