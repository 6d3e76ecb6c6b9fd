"""Alembic's environment: each file of `versions/` takes a store one step on; `schema.HEAD` is the last."""
