"""Imagined steps a second of a policy search: ours, and Stable-Baselines3's PPO around the same learned ensemble.

Both search with the paper's networks and settings (Table 2 for InvertedPendulum-v5, Table 3 for HalfCheetah-v5), with
hallucinated control as p more actions, in the same fitted ensemble, under the same reward network, on one core.
Stable-Baselines3 gets the ensemble as a Gymnasium environment, by the fastest of three ways to compute it.
Beside them our search by gradients with the default settings.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.common import Report, Timed, add_core, one_core, parser, progress, timed
from benchmarks.sb3 import sb3_python

if TYPE_CHECKING:
    from benchmarks.setting import Setting

TASKS = {"InvertedPendulum-v5": "Table 2", "HalfCheetah-v5": "Table 3"}


def arguments() -> argparse.Namespace:
    """The command line."""
    made = parser(__doc__)
    made.add_argument("--task", choices=(*TASKS, "both"), default="both", help="whose table of settings")
    made.add_argument("--seed", type=int, default=0, help="of data, models and searches")
    made.add_argument("--repeats", type=int, default=3, help="searches, of which the fastest counts")
    made.add_argument("--sb3-steps", type=int, default=20_000, help="imagined steps of Stable-Baselines3")
    made.add_argument("--no-sb3", action="store_true", help="only ours")
    add_core(made)
    return made.parse_args()


def main() -> None:
    """Measures and reports."""
    options = arguments()
    one_core(options.core)
    report = Report("Policy search in the learned ensemble: imagined steps a second")
    for task in TASKS if options.task == "both" else [options.task]:
        one_task(task, options, report)
    report.notes.append(
        "compile_s: CPU seconds to build the program, once a run (a cache keeps it for later runs). steps_per_s: "
        "imagined steps a CPU second (on a GPU: a second), compilation apart. times_sb3: the same over "
        "Stable-Baselines3's."
    )
    report.show()
    report.write(options.json, seed=options.seed, repeats=options.repeats)


def one_task(task: str, options: argparse.Namespace, report: Report) -> None:
    """Both searches in one task's ensemble."""
    import jax.random as jr

    from benchmarks.setting import setting
    from hiprl.config import Config, paper
    from hiprl.control.gradient import GradientConfig

    key = jr.key(options.seed)
    config = paper(task)
    ppo = config.search
    if options.quick:
        ppo = replace(ppo, total_timesteps=4 * ppo.n_steps, trial_steps=20)
        config = replace(config, dynamics=replace(config.dynamics, cold_steps=100), search=ppo)
    made = one_reward_network(setting(task, config, key=key))
    p, q = made.world.p, made.world.q
    about = {"task": task, "p": p, "q": q}
    sb3 = None
    if not options.no_sb3:
        progress(f"{task}: Stable-Baselines3")
        steps = 2 * ppo.n_steps if options.quick else -(-options.sb3_steps // ppo.n_steps) * ppo.n_steps
        sb3 = search_by_sb3(made, ppo, task, steps=steps, seed=options.seed)
        report.add(
            **about,
            search=f"sb3 ppo, {TASKS[task]}, {sb3['forward']}",
            steps=steps,
            cpu_s=sb3["cpu"],
            wall_s=sb3["wall"],
            steps_per_s=steps / sb3["cpu"],
        )
    repeats = 1 if options.quick else options.repeats
    progress(f"{task}: our ppo")
    compile_s, took = search_by_us(made, ppo, key=key, repeats=repeats)
    steps = -(-ppo.total_timesteps // ppo.n_steps) * ppo.n_steps
    report.add(**about, search=f"hiprl ppo, {TASKS[task]}", **numbers(steps, compile_s, took, sb3))

    progress(f"{task}: our search by gradients, default settings")
    config = Config()
    gradient = GradientConfig()
    if options.quick:
        gradient = replace(gradient, chunks=1, updates=2, settling=1, trial_steps=20)
        config = replace(config, dynamics=replace(config.dynamics, cold_steps=100))
    made = setting(task, replace(config, search=gradient), key=key)
    compile_s, took = search_by_us(made, gradient, key=key, repeats=repeats)
    updates = gradient.settling + gradient.chunks * gradient.updates
    steps = updates * config.dynamics.M * gradient.rollouts * gradient.steps
    report.add(**about, search="hiprl gradient, default", **numbers(steps, compile_s, took, None))


def one_reward_network(made: Setting) -> Setting:
    """The paper's one network in place of the several that give σ_g: the other side computes one."""
    import jax

    reward = made.reward
    return made._replace(reward=replace(reward, nets=jax.tree.map(lambda x: x[:1], reward.nets)))


def numbers(steps: int, compile_s: float, took: Timed, sb3: dict[str, Any] | None) -> dict[str, Any]:
    """What was measured of a search of ours, beside the other side's."""
    rate = steps / took.seconds
    row = {"steps": steps, "cpu_s": took.cpu, "wall_s": took.wall, "compile_s": compile_s, "steps_per_s": rate}
    return row if sb3 is None else row | {"times_sb3": rate / (sb3["steps"] / sb3["cpu"])}


def search_by_us(made: Setting, config: Any, *, key: Any, repeats: int) -> tuple[float, Timed]:
    """Seconds to compile, and seconds of a search."""
    import jax

    from hiprl.control.search import search

    jax.config.update("jax_enable_compilation_cache", False)
    arguments = (made.f_tilde, made.reward, made.ends, made.T, made.state)
    began = time.process_time()
    compiled = search.lower(*arguments, config, key=key).compile()
    compile_s = time.process_time() - began
    return compile_s, timed(lambda: compiled(*arguments, key=key), repeats=repeats)


def search_by_sb3(made: Setting, config: Any, task: str, *, steps: int, seed: int) -> dict[str, Any]:
    """What the other side measured; it has to agree with us on where a step leads."""
    import numpy as np

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.npz"
        settings = {"task": task, "H": made.world.H, "steps": steps, "seed": seed, "ppo": asdict(config)}
        np.savez(path, settings=np.array(json.dumps(settings)), **arrays(made))
        command = [sb3_python(), Path(__file__).with_name("sb3_side.py"), "search", path]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"Stable-Baselines3's side failed:\n{done.stderr}")
    found = json.loads(done.stdout.splitlines()[-1])
    if found["disagreement"] > 1e-3:
        raise SystemExit(f"the two sides disagree on the model by {found['disagreement']:.2g} of a typical step")
    return found


def arrays(made: Setting) -> dict[str, Any]:
    """The model as arrays, and some steps in it, without noise, that the other side has to give as well."""
    import jax
    import jax.numpy as jnp
    import jax.random as jr
    import numpy as np

    stack, reward, f_tilde = made.f_tilde.dynamics.stack, made.reward, made.f_tilde
    s = made.T.transitions().s[: 8 * 100 : 100]
    u = jr.uniform(jr.key(0), (8, made.world.q + f_tilde.eta_size), minval=-1.0, maxval=1.0)
    still = jnp.zeros(made.world.p)
    s_next, _ = jax.vmap(lambda s, u: f_tilde.step(s, u, draw=still))(s, u)
    r = jax.vmap(lambda s, u: reward(s, f_tilde.split(u)[0]))(s, u)
    parts = {f"W{i}": w for i, w in enumerate(stack.net.weights)}
    parts |= {f"b{i}": b for i, b in enumerate(stack.net.biases)}
    parts |= {f"rW{i}": w[0] for i, w in enumerate(reward.nets.weights)}
    parts |= {f"rb{i}": b[0] for i, b in enumerate(reward.nets.biases)}
    parts |= {
        "in_mean": stack.inputs.mean[0],
        "in_std": stack.inputs.std[0],
        "step_mean": stack.steps.mean[0],
        "step_std": stack.steps.std[0],
        "r_mean": reward.inputs.mean,
        "r_std": reward.inputs.std,
        "beta": f_tilde.beta,
        "low": f_tilde.low,
        "high": f_tilde.high,
        "first": made.T.first_states(),
        "check_s": s,
        "check_u": u,
        "check_next": s_next,
        "check_r": r,
    }
    return {name: np.asarray(x) for name, x in parts.items()}


if __name__ == "__main__":
    main()
