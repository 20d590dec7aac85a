"""Controllers: ``decide(observation) -> decision``."""
