"""The command line: one dataclass a command, read by tyro."""
