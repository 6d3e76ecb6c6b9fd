"""Share of this machine's matrix-product rate that fits and searches reach.

The arithmetic of a fit or a search is products of matrices. Each product that one unit of work needs (a gradient step
of the ensemble's fit, an update of a search) is listed with its shape, and timed alone, back to back in one compiled
loop: so many seconds would the unit take if nothing else cost anything. The share is that over what it takes.
Counted are all layers forward and, where there is a gradient, backward to inputs and to weights; not counted is what
is no matrix product: activations, draws, the optimiser, the reward's features.

A machine that others use too is now faster, now slower: in each round a program runs once and its products right
after it, and the median of the rounds' shares counts.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING, Any, Literal

from benchmarks.common import Report, add_core, one_core, parser, progress, timed

if TYPE_CHECKING:
    from benchmarks.setting import Setting
    from hiprl.control.gradient import GradientConfig
    from hiprl.control.ppo import PPOConfig
    from hiprl.models.dynamics import DynamicsConfig

SECONDS = 0.2  # that one product is repeated for, in each round
LARGE = 1024  # side of the square product shown for comparison


@dataclass(frozen=True)
class Product:
    """M products of (B, i) and (i, o), or of the same size turned round as the backward pass needs them."""

    M: int
    B: int
    i: int
    o: int
    kind: Literal["forward", "to input", "to weight"]

    @property
    def flops(self) -> int:
        """Multiplications and additions."""
        return 2 * self.M * self.B * self.i * self.o


Work = Counter[Product]
"""Products, and how often each is needed."""


def network(M: int, B: int, sizes: tuple[int, ...], *, weights: bool = False, inputs: bool = False) -> Work:
    """One pass of M networks over B rows each.

    Args:
        M: networks.
        B: rows.
        sizes: of input, hidden layers and output.
        weights: whether the gradient of the weights is taken.
        inputs: whether the gradient of the input is taken.
    """
    work: Work = Counter()
    for layer, (i, o) in enumerate(pairwise(sizes)):
        work[Product(M, B, i, o, "forward")] += 1
        if weights:
            work[Product(M, B, i, o, "to weight")] += 1
        if inputs or (weights and layer > 0):
            work[Product(M, B, i, o, "to input")] += 1
    return work


def times(n: float, work: Work) -> Work:
    """The same work `n` times."""
    return Counter({product: n * count for product, count in work.items()})


def fit_work(config: DynamicsConfig, p: int, q: int) -> Work:
    """A gradient step of the ensemble's fit, with its share of a look at the held-out loss."""
    sizes = (p + q, *config.layers(p + q), 2 * p)
    return network(config.M, config.batch, sizes, weights=True) + times(
        1 / config.chunk, network(config.M, 1024, sizes)
    )


def gradient_work(config: GradientConfig, made: Setting) -> Work:
    """An update of the search by gradients, with its share of trials and of what comes before the first update."""
    p, size, M, dynamics, everywhere = shapes(made)
    n = M * config.rollouts
    policy, value = (p, *config.layers(p), 2 * size), (p, *config.layers(p), 1)
    rows = n if everywhere else config.rollouts
    step = network(M, rows, dynamics, inputs=True) + network(1, n, policy, weights=True, inputs=True)
    plain = network(M, rows, dynamics) + network(1, n, policy)  # while the value settles
    acts = network(1, M * config.trial_starts, policy)
    look = network(M, M * config.trial_starts, dynamics) + acts  # each trial asks all members
    last = network(M, config.trial_starts, dynamics) + acts
    fit = times(config.value_updates, network(1, n * config.steps // config.value_updates, value, weights=True))
    fit += network(1, n * config.steps, value)  # its mean error
    tried = min(config.trial_steps, made.world.H)
    settling = times(config.steps, plain) + network(1, n * config.steps, value) + fit
    return (
        times(config.steps, step)
        + network(1, n * config.steps, value, inputs=True)
        + fit
        + times(config.settling / (config.chunks * config.updates), settling)
        + times(tried / config.updates, look)
        + times(tried / (config.chunks * config.updates), last)
    )


def ppo_work(config: PPOConfig, made: Setting) -> Work:
    """An iteration of PPO: imagined steps, values, and the passes over them."""
    p, size, M, dynamics, everywhere = shapes(made)
    policy, value = (p, *config.hidden, size), (p, *config.hidden, 1)
    rows = config.rollouts if everywhere else config.rollouts // M
    step = network(M, rows, dynamics) + network(1, config.rollouts, policy)
    batches = -(-config.n_steps // config.batch_size)
    batch = network(1, config.batch_size, policy, weights=True) + network(1, config.batch_size, value, weights=True)
    nets = made.reward.nets
    reward = (nets.weights[0].shape[1], *(b.shape[-1] for b in nets.biases))
    members = nets.weights[0].shape[0]
    return (
        times(config.length, step)
        + times(2, network(1, config.n_steps, value))
        + network(members, config.n_steps, reward)
        + times(config.n_epochs * batches, batch)
    )


def shapes(made: Setting) -> tuple[int, int, int, tuple[int, ...], bool]:
    """p, size of the policy's output, M, the members' layers, and whether each rollout asks all members."""
    p, f_tilde = made.world.p, made.f_tilde
    stack = made.dynamics.ensemble.stack
    sizes = (stack.net.weights[0].shape[1], *(b.shape[1] for b in stack.net.biases))
    return p, made.world.q + f_tilde.eta_size, made.dynamics.ensemble.M, sizes, f_tilde.mode != "thompson"


class Alone:
    """One such product, repeated in one compiled loop."""

    def __init__(self, product: Product) -> None:
        import jax
        import jax.numpy as jnp
        import jax.random as jr

        M, B, i, o = product.M, product.B, product.i, product.o
        left_shape, right_shape, spec = {
            "forward": ((M, B, i), (M, i, o), "mbi,mio->mbo"),
            "to input": ((M, B, o), (M, i, o), "mbo,mio->mbi"),
            "to weight": ((M, B, i), (M, B, o), "mbi,mbo->mio"),
        }[product.kind]
        if M == 1:
            left_shape, right_shape, spec = left_shape[1:], right_shape[1:], spec.replace("m", "")
        left_key, right_key = jr.split(jr.key(0))
        self.pair = jr.normal(left_key, left_shape), jr.normal(right_key, right_shape)

        @jax.jit
        def loop(left: Any, right: Any, n: Any) -> Any:
            def body(_: Any, carry: tuple[Any, Any]) -> tuple[Any, Any]:
                left, out = carry
                left = left.at[(0,) * left.ndim].set(1e-3 * out[(0,) * out.ndim])  # so that none can be left out
                return left, jnp.einsum(spec, left, right)

            return jax.lax.fori_loop(0, n, body, (left, jnp.einsum(spec, left, right)))

        self.loop, self.n = loop, 1
        self.seen: list[float] = []
        self.seconds()
        self.n = 4
        while (took := self.n * self.seconds()) < SECONDS / 10:
            self.n *= 4
        self.n = max(1, int(self.n * SECONDS / took))
        self.seen.clear()

    def seconds(self) -> float:
        """How long one product takes now."""
        self.seen.append(timed(lambda: self.loop(*self.pair, self.n), repeats=1).seconds / self.n)
        return self.seen[-1]


@dataclass
class Measured:
    """A fit or a search: its products, and what it takes."""

    name: str
    unit: str
    work: Work
    units: int
    """In one run of the program."""
    compile_s: float
    run: Callable[[], Any]
    takes: list[float] = field(default_factory=list)
    """Seconds a unit, in each round."""
    products: list[float] = field(default_factory=list)
    """Seconds of its products alone, right after."""

    @property
    def flops(self) -> int:
        """Of a unit."""
        return sum(product.flops * count for product, count in self.work.items())

    def once(self, alone: dict[Product, Alone]) -> None:
        """A run of the program, and each of its products, while the machine is as fast as it is now."""
        self.takes.append(timed(self.run, repeats=1).seconds / self.units)
        self.products.append(sum(alone[product].seconds() * count for product, count in self.work.items()))


def compiled(lowered: Any) -> tuple[Any, float]:
    """The program, and the CPU seconds to build it."""
    began = time.process_time()
    program = lowered.compile()
    return program, time.process_time() - began


def measure(options: argparse.Namespace) -> Iterator[Measured]:
    """The fit and the searches, one after the other."""
    import jax
    import jax.random as jr

    from benchmarks.setting import setting
    from hiprl.config import Config, paper
    from hiprl.control.search import search
    from hiprl.models.dynamics import estimate_dynamics

    jax.config.update("jax_enable_compilation_cache", False)
    key = jr.key(options.seed)
    default = Config(optimism=options.optimism) if options.optimism else Config()
    for preset, config in ("default", default), ("paper", paper(options.env)):
        model, searching = config.dynamics, config.search
        if options.quick:
            model = replace(model, cold_steps=200, warm_steps=200)
            short = {
                "default": {"chunks": 1, "updates": 4, "settling": 1, "trial_steps": 20},
                "paper": {"total_timesteps": 1024},
            }
            searching = replace(searching, **short[preset])
        made = setting(options.env, replace(config, dynamics=model, search=searching), key=key)
        p, q = made.world.p, made.world.q

        jax.clear_caches()  # the setting has built the same program
        progress(f"{preset}: compiles its fit of the ensemble")
        steps = model.warm_steps
        program, compile_s = compiled(estimate_dynamics.lower(made.T, made.dynamics, model, steps=steps, key=key))
        run = partial(program, made.T, made.dynamics, steps=steps, key=key)
        yield Measured(f"{preset}: fit", "gradient step", fit_work(model, p, q), steps, compile_s, run)

        progress(f"{preset}: compiles its search")
        arguments = (made.f_tilde, made.reward, made.ends, made.T, made.state)
        program, compile_s = compiled(search.lower(*arguments, searching, key=key))
        if preset == "default":
            work, unit, units = gradient_work(searching, made), "update", searching.chunks * searching.updates
        else:
            units = -(-searching.total_timesteps // searching.n_steps)
            work, unit = ppo_work(searching, made), "iteration"
        yield Measured(f"{preset}: search", unit, work, units, compile_s, partial(program, *arguments, key=key))


def main() -> None:
    """Measures and reports."""
    made = parser(__doc__)
    made.add_argument("--env", default="HalfCheetah-v5", help="whose shapes and data")
    made.add_argument("--optimism", default=None, help="mode of the default's search (default: the preset's own)")
    made.add_argument("--seed", type=int, default=0, help="of data, models and searches")
    made.add_argument("--rounds", type=int, default=5, help="rounds, of which the median counts")
    made.add_argument("--products", action="store_true", help="also show each product")
    add_core(made)
    options = made.parse_args()
    if options.quick:
        globals()["SECONDS"] = 0.01
    one_core(options.core)

    found = list(measure(options))
    large = Product(1, LARGE, LARGE, LARGE, "forward")
    products = list(dict.fromkeys([product for one in found for product in one.work] + [large]))
    progress(f"compiles {len(products)} products, each alone")
    alone = {product: Alone(product) for product in products}
    rounds = 1 if options.quick else options.rounds
    for one in found:
        timed(one.run, repeats=1)  # the first call of a program is slower
    for now in range(rounds):
        progress(f"round {now + 1} of {rounds}")
        for one in found:
            one.once(alone)
        alone[large].seconds()

    report = Report(f"{options.env}: share of the matrix-product rate at the same shapes")
    for one in found:
        shares = [products / takes for products, takes in zip(one.products, one.takes, strict=True)]
        report.add(
            what=one.name,
            unit=one.unit,
            mflop=one.flops / 1e6,
            products_ms=1e3 * median(one.products),
            takes_ms=1e3 * median(one.takes),
            attainable_gflop_s=one.flops / median(one.products) / 1e9,
            reached_gflop_s=one.flops / median(one.takes) / 1e9,
            share=median(shares),
            least=min(shares),
            most=max(shares),
            compile_s=one.compile_s,
        )
    each = {product: median(one.seen) for product, one in alone.items()}
    report.notes.append(
        f"The same machine gives {large.flops / each[large] / 1e9:.0f} GFLOP/s on a square product of {LARGE}. "
        "Times are CPU seconds (on a GPU: seconds); compile_s is spent once a run at most."
    )
    report.show()
    rows = [
        {**vars(product), "us": 1e6 * s, "gflop_s": product.flops / s / 1e9, "in": uses(product, found)}
        for product, s in each.items()
    ]
    if options.products:
        Report("The products alone", rows).show()
    report.write(options.json, seed=options.seed, rounds=rounds, products=rows)


def uses(product: Product, found: list[Measured]) -> str:
    """In which programs a product occurs, and how often a unit."""
    return ", ".join(f"{one.name} x {one.work[product]:g}" for one in found if product in one.work)


if __name__ == "__main__":
    main()
