"""Plans: how a decision is written, checked and carried out by devices."""
