"""Where trajectories come from: any Gymnasium environment, and small tasks in pure JAX."""
