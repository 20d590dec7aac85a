"""Plans: how a decision is told, checked and carried out by devices."""
