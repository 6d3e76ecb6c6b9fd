"""Runs, trajectories, questions, answers and checkpoints, where trainers and pages meet."""
