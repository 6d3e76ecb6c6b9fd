"""The labelling page: knows the store and nothing of trainers."""
