"""What hiprl reaches, measured: each module is a program, `python -m benchmarks.NAME --help`."""
