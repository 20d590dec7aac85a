"""A guard around any controller: checks, estimates and fallbacks."""
