"""`hiprl show` and `hiprl compare`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from hiprl.cli.commands import DEFAULT_STORE, Compare, Facts, Show
from hiprl.cli.progress import duration
from hiprl.cli.saying import say
from hiprl.errors import InputError
from hiprl.models.estimate import RewardConfig
from hiprl.models.reward import AdditiveConfig
from hiprl.report.arm_figure import comparison
from hiprl.report.arms import arms_of, compared
from hiprl.report.beliefs import beliefs
from hiprl.report.evidence import Told, evidence_of, opinions, quality, told
from hiprl.report.figures import headline, pictures
from hiprl.report.record import Record, beside, newest, record
from hiprl.report.setting import setting
from hiprl.report.style import save
from hiprl.report.summary import summary
from hiprl.spec import from_plain
from hiprl.store.rows import RunRow
from hiprl.store.store import Store, open_store

FOLDS = 5  # parts into which the answers are put, each predicted from the others
PIPE_WIDTH = 200  # letters of a line where there is no terminal


def show(command: Show) -> Facts:
    """Prints the numbers of a run and writes its pictures; gives the numbers and where the pictures are."""
    with open_store(command.store, create=False) as store:
        run = record(store, newest(store) if command.run is None else store.find_run(command.run))
        config = from_plain(run.row.spec["config"]).reward
        learned = told_by(store, run, config)
        judges = {} if learned is None else opinions(store, run.row, learned.P, learned.reward)
        others = [] if command.run is not None else [record(store, row) for row in store.runs()]
    folder = Path(command.out).expanduser() if command.out is not None else beside(command.store, run.id)
    facts = summary(run)
    out = output(command.json)
    if len(others) > 1:
        out.print(table_of_runs(others))
    figures = pictures(run)
    if learned is not None:
        facts |= quality(learned.T, learned.P, config, folds=FOLDS) | {"weights": learned.weights}
        facts |= judges
        unit = float(learned.reward.unit)
        figures["beliefs"] = beliefs(
            learned.shapes, unit, learned.names, headline(run), going_on=learned.reward.going_on
        )
    out.print(table_of_numbers(run, facts))
    return facts | {"pictures": saved(figures, folder)}


def told_by(store: Store, run: Record, config: RewardConfig) -> Told | None:
    """What a run's answers say of the reward; None if it has none, or learns it by networks."""
    if not isinstance(config, AdditiveConfig) or not any(q.answer is not None for q in store.questions(run.id)):
        return None
    return told(run.row, *evidence_of(store, run.row), config)


def compare(command: Compare) -> Facts:
    """Prints arms side by side and writes their picture; gives the numbers and where the picture is."""
    if command.all == bool(command.runs):
        raise InputError(
            ("got runs and --all" if command.all else "got no run to compare")
            + "; either some runs or all of them are compared. Write hiprl compare RUN RUN, or hiprl compare --all."
        )
    stores = command.store or (DEFAULT_STORE,)
    records = found(command.runs, stores)
    arms = arms_of(records)
    lines = compared(arms, reach=command.reach)
    output(command.json).print(table_of_arms(lines))
    unfinished = [run.id for arm in arms for run in arm.runs if run.final is None]
    if unfinished:
        say(f"Not finished, so without a final return: {', '.join(unfinished)}.")
    compared_ids = {run.id for arm in arms for run in arm.runs}
    again = [run.id for run in records if run.id not in compared_ids]
    if again:
        say(f"Left out, as another run has the same settings and seed: {', '.join(again)}.")
    folder = Path(command.out).expanduser() if command.out is not None else beside(stores[0], "comparison")
    return {
        "arms": lines,
        "unfinished": unfinished,
        "stores": [*dict.fromkeys(run.store for run in records)],
        "pictures": saved({"comparison": comparison(arms)}, folder),
    }


def found(runs: Sequence[str], stores: Sequence[str]) -> list[Record]:
    """The runs of these ids, each in the first store that has it; all runs if none is named.

    Raises:
        InputError: no store has the run, or there is none at all.
    """
    records: list[Record] = []
    names: list[str] = []
    missing = dict.fromkeys(runs)
    for where in stores:
        with open_store(where, create=False) as store:
            names.append(store.name)
            if not runs:
                records += [record(store, row) for row in store.runs()]
            for name in [*missing]:
                if (row := found_in(store, name, last=where == stores[-1])) is not None:
                    records.append(record(store, row))
                    del missing[name]
    if not records:
        raise InputError(
            f"there is no run in {' or '.join(names)} yet; at least one is needed. "
            "Begin one with `hiprl train`, or name another store with --store."
        )
    return records


def found_in(store: Store, name: str, *, last: bool) -> RunRow | None:
    """The run of this id or prefix; None if there is none and this is not the last store."""
    if last or any(row.id.startswith(name.lower()) for row in store.runs()):
        return store.find_run(name)
    return None


def saved(figures: dict, folder: Path) -> list[str]:
    """Writes the pictures and says where."""
    paths = [str(path) for path in save(figures, folder)]
    say("Pictures: " + paths[0] + (f" and {len(paths) - 1} more beside it" if len(paths) > 1 else ""))
    return paths


def output(json: bool) -> Console:
    """Where tables go: to stdout, but to stderr if stdout is to end with JSON. A pipe has no width to keep to."""
    console = Console(stderr=json)
    if not console.is_terminal:
        console.width = PIPE_WIDTH
    return console


def table_of_runs(runs: Sequence[Record]) -> Table:
    """One line a run, oldest first."""
    table = Table("run", "environment", "settings", "seed", "comparisons", "return", box=box.SIMPLE_HEAD)
    for run in runs:
        mean = (run.final or {}).get("return_mean")
        table.add_row(
            run.id,
            run.row.env,
            setting(run.row).words(),
            str(run.row.seed),
            f"{run.answered} of {run.planned}",
            "not finished" if run.final is None else "not known" if mean is None else f"{mean:.1f}",
        )
    return table


def table_of_numbers(run: Record, facts: Facts) -> Table:
    """What is told of one run."""
    table = Table("run", run.id, box=box.SIMPLE_HEAD)
    returned = (
        f"not finished; go on with `hiprl resume {run.id} --store {run.store}`"
        if not facts["finished"]
        else "not known: no reward is paid"
    )
    if facts["return_mean"] is not None:
        n = facts["eval_episodes"]
        returned = f"{facts['return_mean']:.1f} ± {facts['return_std']:.1f} over {n} episode{'s' if n > 1 else ''}"
    seconds = facts["seconds"]
    for name, words in {
        "environment": f"{facts['env']}, seed {facts['seed']}",
        "settings": setting(run.row).words(),
        "comparisons": f"{facts['comparisons']} of {facts['planned_comparisons']}, by judge {facts['judge']}",
        "steps in the environment": f"{facts['env_steps']}",
        "return of the learned policy": returned,
        "predicted answers, error": f"{known(facts['preference_deviation'])} in units of the return",
        "predicted answers, right sign": percent(facts["right_signs"]),
        "α, times σ of an answer": known(facts["alpha"]),
        "worth of the next answer": worth_in_words(facts["worth"]),
        **(words_of(facts) if "held_out_accuracy" in facts else {}),
        "dynamics, one-step error": f"{known(facts['deviation'])} in units of the state",
        "dynamics, h-step error": ", ".join(f"{h}: {known(x)}" for h, x in facts["rollout_errors"].items()) or "-",
        "dynamics, coverage of 90 %": percent(facts["coverage"]),
        "β, times σ of a state": known(facts["beta"]),
        "imagined and executed, by r̂": f"{known(facts['imagined'])} and {known(facts['executed'])}",
        "promises far off": f"{facts['overpromised']}",
        "time": f"{duration(facts['wall_seconds'])}: "
        + ", ".join(f"{x} {duration(s)}" for x, s in seconds.items() if round(s)),
    }.items():
        table.add_row(name, words)
    return table


def words_of(facts: Facts) -> dict[str, str]:
    """How good a learned reward is, in words."""
    likely = facts["held_out_log_likelihood"]
    said = {
        "kept answers, right side": percent(facts["held_out_accuracy"]),
        "kept answers, log likelihood": "-" if likely is None else f"{likely:.4g} nats an answer",
        "kept numbers in their 90 % interval": percent(facts["coverage_90"]),
        "same question, same side": percent(facts["consistency"]),
        "same question, another judge": percent(facts.get("agreement")),
        "judges": ", ".join(map(judge_in_words, facts.get("judges", []))) or "-",
    }
    goes_by = ", ".join(f"{name} {percent(share)}" for name, share in facts["weights"].items())
    return {name: words for name, words in said.items() if words != "-"} | {"r̂ goes by": goes_by}


def judge_in_words(one: Facts) -> str:
    """A judge, with what they gave and how often they err."""
    erring = "" if one["mistakes"] is None else f", errs in {percent(one['mistakes'])}"
    return f"{one['judge']} ({one['answers']} answers{erring})"


def table_of_arms(lines: Sequence[Facts]) -> Table:
    """One line an arm."""
    names = ("environment", "arm", "runs", "return (IQM)", "95 % interval", "to reach", "comparisons", "a run takes")
    table = Table(*names, box=box.SIMPLE_HEAD)
    for one in lines:
        n, low, high = len(one["runs"]), one["return_low"], one["return_high"]
        reached = f"{known(one['comparisons_needed'])} ({one['reached']} of {n} runs)"
        table.add_row(
            one["env"],
            one["arm"],
            f"{n}" if one["finished"] == n else f"{n}, {one['finished']} with a return",
            known(one["return_iqm"]),
            "-" if low is None else f"{known(low)} to {known(high)}",
            known(one["reach"]),
            "-" if one["reach"] is None else reached,
            "-" if one["wall_seconds"] is None else duration(one["wall_seconds"]),
        )
    return table


def known(x: float | None) -> str:
    """A number in four digits, or a dash."""
    return "-" if x is None else f"{x:.4g}"


def worth_in_words(x: float | None) -> str:
    """What an answer is worth, or a dash."""
    return "-" if x is None else f"{f'{100 * x:.1f}' if x >= 1e-3 else 'under 0.1'} % of what was learned"


def percent(x: float | None) -> str:
    """A share in percent, or a dash."""
    return "-" if x is None else f"{100 * x:.0f} %"
