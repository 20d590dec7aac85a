"""What controllers and plant agree on: forecast, observation, decision. Neither knows the other."""
