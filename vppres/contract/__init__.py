"""Data that controllers and plant exchange: forecast, observation, decision."""
