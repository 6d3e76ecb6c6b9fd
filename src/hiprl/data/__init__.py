"""What was seen and what was said: transitions, trajectories τ and their set T, preferences g and their set P."""
