"""The settings of a run, all parts together, and the presets."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias, get_args

from hiprl.control.gradient import GradientConfig
from hiprl.control.plan import PlanConfig
from hiprl.control.ppo import PPOConfig
from hiprl.control.search import SearchConfig
from hiprl.errors import InputError
from hiprl.feedback.judging import Judging
from hiprl.feedback.questions import Pick, QuestionConfig
from hiprl.hallucinated import OPTIMISM, Optimism
from hiprl.models.dynamics import DynamicsConfig
from hiprl.models.estimate import RewardConfig
from hiprl.models.reward import AdditiveConfig
from hiprl.models.reward_network import NetworkConfig

Preset: TypeAlias = Literal["default", "paper"]
Babble: TypeAlias = Literal["varied", "uniform"]
CLIP = 50
"""Steps of a clip where a judge does not give numbers: 2 to 5 seconds in most simulators."""
PRESETS: tuple[Preset, ...] = get_args(Preset)


@dataclass(frozen=True, kw_only=True)
class Config:
    """How a run learns. Plain values only: a run can be done again from these, the seed and the world."""

    comparisons: int = 30
    """K, the answers that the judge gives."""
    warm_up: int = 5
    """Trajectories with random actions at the start; the comparisons between them count (section 5)."""
    babble: Babble = "varied"
    """Random actions: `uniform` over their whole box (the paper), or in each episode over a box of `varied` size."""
    optimism: Optimism = "thompson"
    """How the search may use what the dynamics model does not know."""
    kappa: float = 1.0
    """β is the calibrated width times this."""
    kappa_decay: float = 1.0
    """What κ is multiplied by after each episode with a searched policy."""
    bonus: float = 1.0
    """In mode `bonus`: reward for a σ as large as a typical step, in units of a typical reward."""
    restart: bool = True
    """Begin each search at the executed policy that r̂ ranks best; False: at the newest one (the paper)."""
    practice: int = 0
    """Episodes after each answer that nobody is asked about. They cost steps and time, and no answers."""
    confirmations: int = 40
    """Episodes after the last answer in which what r̂ ranks best is executed again, so that luck does not win."""
    dynamics: DynamicsConfig = field(default_factory=DynamicsConfig)
    """The model of the world."""
    reward: RewardConfig = field(default_factory=AdditiveConfig)
    """The model of the judge."""
    search: SearchConfig = field(default_factory=GradientConfig)
    """The search for a policy in the model."""
    plan: PlanConfig = field(default_factory=PlanConfig)
    """What is executed, given a policy."""
    question: QuestionConfig = field(default_factory=QuestionConfig)
    """What the judge is asked."""

    def __post_init__(self) -> None:
        if self.comparisons < 2:
            raise InputError(
                f"got {self.comparisons} comparisons; at least 2 are needed. Say for example `--comparisons 30`."
            )
        if not 2 <= self.warm_up <= self.comparisons:
            raise InputError(
                f"got a warm-up of {self.warm_up} trajectories and {self.comparisons} comparisons; the warm-up needs "
                "at least 2 trajectories and at most as many as there are comparisons. Change one of the two."
            )
        if self.practice < 0:
            raise InputError(
                f"got {self.practice} episodes of practice after each answer; 0 or more are possible. "
                "Take 0 to execute no more than is asked about."
            )
        if self.confirmations < 0:
            raise InputError(
                f"got {self.confirmations} confirmations; the number of episodes in which the best policies are tried "
                "again is 0 or more. Take 40."
            )
        if self.optimism not in OPTIMISM:
            raise InputError(
                f"got the optimism {self.optimism!r}; it is one of {', '.join(OPTIMISM)}. "
                "Choose one of these with `--optimism`."
            )
        if self.babble not in get_args(Babble):
            raise InputError(
                f"got babble {self.babble!r}; it is one of {', '.join(get_args(Babble))}. "
                "Take `varied`: episodes of different effort tell more."
            )
        if not (self.kappa >= 0 and self.kappa_decay > 0 and self.bonus >= 0):
            raise InputError(
                f"got kappa {self.kappa}, kappa_decay {self.kappa_decay} and bonus {self.bonus}; widths and bonuses "
                "are 0 or more, and the decay is above 0. Use 0 for no optimism."
            )

    @property
    def trajectories(self) -> int:
        """How many there are from τ_0 to the last answer's practice."""
        return self.number_after(self.comparisons)

    def practice_after(self, k: int) -> int:
        """Episodes of practice after answer k: none in the warm-up, which has no policy yet."""
        return self.practice if k >= self.warm_up else 0

    def searches_after(self, k: int) -> int:
        """How many policies were searched when all is done that belongs to answer k."""
        return (1 + self.practice) * max(0, k - self.warm_up + 1)

    def executed_after(self, k: int) -> int:
        """How many trajectories were executed then."""
        return 1 + min(k, self.warm_up - 1) + self.searches_after(k)

    def number_after(self, k: int) -> int:
        """How many trajectories there are then, with those that were imagined to be asked about."""
        return self.executed_after(k) + (self.searches_after(k) if self.question.imagined else 0)

    def eta_size(self, p: int) -> int:
        """How many entries of the policy's output are hallucinated control."""
        return p if self.optimism == "eta_policy" else 0


def asking(
    config: Config,
    judging: Judging,
    *,
    clip: int | None = None,
    pick: Pick | None = None,
    practice: int | None = None,
    imagined: bool = False,
) -> Config:
    """The settings with questions that this judge can answer.

    Numbers are given for whole trajectories, any of which will do (the paper). Answers with less in them are asked of
    clips, and of those clips that tell most: whole episodes picked at random do not get there. They are also
    what there is least of, so that an episode of practice follows each.

    Args:
        config: the settings.
        judging: who answers.
        clip: steps of a clip; 0 for whole trajectories, None for what suits the judge.
        pick: how clips are picked; None for what suits the judge.
        practice: episodes of practice after each answer; None for what suits the judge, or what `config` has if more.
        imagined: ask about what a new policy does in the model as well.
    """
    telling = judging.form not in (None, "number")
    levels = {"choice": 2, "level": judging.levels, "rating": judging.levels, "slider": 5}.get(str(judging.form))
    asked = config.question
    if judging.form is not None:
        asked = replace(asked, items=judging.items, levels=levels)
    if telling:
        asked = replace(asked, clip=CLIP, pick="information")
    if clip is not None:
        asked = replace(asked, clip=clip or None)
    if imagined:
        asked = replace(asked, imagined=True)
    if practice is None:
        practice = max(config.practice, 1) if telling else config.practice
    return replace(config, question=asked if pick is None else replace(asked, pick=pick), practice=practice)


def teachable(config: Config) -> Config:
    """The settings with questions that people can answer: two short clips, those that tell most, five levels."""
    asked = replace(config.question, clip=config.question.clip or CLIP, pick="information", levels=5, items=2)
    return replace(config, question=asked, practice=max(config.practice, 1))


PAPER_PENDULUM = PPOConfig()
"""Table 2."""
PAPER_CHEETAH = PPOConfig(
    learning_rate=1.0633e-5,
    n_steps=512,
    rollouts=32,
    batch_size=64,
    n_epochs=20,
    gamma=0.98,
    gae_lambda=0.92,
    clip_range=0.1,
    ent_coef=0.000401762,
    vf_coef=0.58096,
    max_grad_norm=0.8,
)
"""Table 3."""


def paper(env: str) -> Config:
    """Appendix B and section 5: two layers of 32, eq. (59), PPO, η by the policy, actions drawn from the policy.

    Table 3 is for HalfCheetah; every other environment gets Table 2, as the paper gives no third.
    """
    return Config(
        babble="uniform",
        optimism="eta_policy",
        restart=False,
        confirmations=0,
        dynamics=DynamicsConfig(
            hidden=(32, 32),
            activation="relu",
            learning_rate=1e-3,
            weight_decay=0.0,
            bootstrap=False,
            quieten=False,
            warm_steps=800,
            chunk=100,
        ),
        reward=NetworkConfig(),
        search=PAPER_CHEETAH if "HalfCheetah" in env else PAPER_PENDULUM,
        plan=PlanConfig(kind="sample", noise=0.0),
    )


def preset(name: str, env: str) -> Config:
    """The settings of a preset, for the environment of this name.

    Raises:
        InputError: there is no such preset.
    """
    if name == "default":
        return Config()
    if name == "paper":
        return paper(env)
    raise InputError(
        f"got the preset {name!r}; the presets are {', '.join(PRESETS)}. Choose one of these with `--preset`."
    )
