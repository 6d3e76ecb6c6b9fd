"""`hiprl` with settings that learn nothing, quickly. Tests run it as a program and stop it."""

from __future__ import annotations

import sys

from hiprl.config import Config
from hiprl.control.gradient import GradientConfig
from hiprl.models.dynamics import DynamicsConfig

TINY = Config(
    warm_up=2,
    dynamics=DynamicsConfig(M=2, hidden=(8,), batch=16, cold_steps=20, warm_steps=20, chunk=10),
    search=GradientConfig(hidden=(8,), chunks=2, updates=3, rollouts=4, steps=3, trial_steps=5, trial_starts=2),
)

if __name__ == "__main__":
    from hiprl.cli import training
    from hiprl.cli.main import main

    training.preset = lambda name, env: TINY
    sys.exit(main())
