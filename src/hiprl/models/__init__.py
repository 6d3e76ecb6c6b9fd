"""What is learned from data: the dynamics, the reward, when episodes end, and how far to trust each."""
