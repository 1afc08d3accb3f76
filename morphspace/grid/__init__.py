"""Arrays on a pixel grid, no faces: displacement fields sampled, inverted, composed, and rendered exactly."""
