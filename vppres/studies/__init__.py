"""Many runs: side by side, and over the values of a parameter."""
