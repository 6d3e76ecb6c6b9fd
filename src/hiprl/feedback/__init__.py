"""Judges that answer by rule."""
