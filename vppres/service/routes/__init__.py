"""What is asked for over HTTP, a module for each subject."""
