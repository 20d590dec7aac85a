"""What the paper's problem does not have: losses and islands, switching rules."""
