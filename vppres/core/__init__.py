"""Foundation of all packages: typed errors, units, read-only arrays, HTML for notebooks."""
