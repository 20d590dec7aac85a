"""What is wrong, who acknowledged it, and who is notified."""
