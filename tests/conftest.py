"""What every test stands on: type checks, JAX switches, a private PostgreSQL, a word on what was left out."""

import itertools
import os
import pwd
import shutil
import signal
import subprocess
import tempfile
from collections import Counter
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from xdist.scheduler import LoadFileScheduling

ROOT = Path(__file__).resolve().parents[1]
CACHE = ROOT / ".cache"
SCRATCH = Path(tempfile.mkdtemp(prefix="hiprl-tests-"))
REQUIRE_ALL = os.environ.get("HIPRL_REQUIRE_ALL", "") not in ("", "0")

# The environment comes before the imports below, and reaches the processes that tests start.
for kind in ("CACHE", "CONFIG", "DATA", "STATE"):
    os.environ[f"XDG_{kind}_HOME"] = str(SCRATCH / kind.lower())
os.environ["MPLBACKEND"] = "Agg"
os.environ["MPLCONFIGDIR"] = str(CACHE / "matplotlib")  # its font list takes seconds to make
os.environ["JAX_COMPILATION_CACHE_DIR"] = str(CACHE / "jax")
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.3"
os.environ.setdefault("JAX_PLATFORMS", "cpu")
# Nearly all the time of the tests is spent on compiling programs that run for a moment. These halve it; a fit in
# earnest would take three times as long.
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_backend_optimization_level=0 --xla_disable_hlo_passes=while-loop-invariant-code-motion"
    " --xla_cpu_use_fusion_emitters=false --xla_cpu_enable_concurrency_optimized_scheduler=false"
    " --xla_cpu_parallel_codegen_split_count=1",
)

# A shell's background jobs ignore Ctrl-C, and so would the programs that tests start and interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)

import hypothesis
import hypothesis.configuration
import jax
import jaxtyping

# Before the first import of hiprl: from here on each annotation is checked as the code runs.
jaxtyping.install_import_hook("hiprl", "beartype.beartype")

jax.config.update("jax_debug_key_reuse", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
# jax_numpy_dtype_promotion stays as it is: under "strict", Optax's Adam does not run.

hypothesis.configuration.set_hypothesis_home_dir(CACHE / "hypothesis")
hypothesis.settings.register_profile(
    "tests",
    max_examples=30,
    deadline=None,  # the first example compiles
    derandomize=True,
    database=None,
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
)
hypothesis.settings.load_profile("tests")


class Together(LoadFileScheduling):
    """The tests of a file share a process, and so do those of files with the same programs: these compile once."""

    ALIKE = (
        ("test_algorithm.py", "test_session.py", "test_api.py", "test_resume.py", "test_blind.py"),
        ("test_questions.py", "test_worth.py"),
    )

    def _split_scope(self, nodeid: str) -> str:
        path = super()._split_scope(nodeid)
        return next((names[0] for names in self.ALIKE if path.endswith(names)), path)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Together:
    """How tests are spread over processes, where there are several."""
    return Together(config, log)


def pytest_unconfigure() -> None:
    """Leave nothing behind."""
    shutil.rmtree(SCRATCH, ignore_errors=True)


def postgres_programs() -> Path | None:
    """Folder of initdb and pg_ctl: from PATH, or where Debian keeps them off it."""
    found = shutil.which("initdb")
    if found:
        return Path(found).resolve().parent
    debian = Path("/usr/lib/postgresql").glob("*/bin/initdb")
    return max((path.parent for path in debian), key=lambda folder: float(folder.parent.name), default=None)


@pytest.fixture(scope="session")
def postgres_folder() -> Iterator[Path]:
    """Where a PostgreSQL of our own listens, on a Unix socket only, until the tests end."""
    programs = postgres_programs()
    if programs is None:
        pytest.skip("PostgreSQL's server is not here (Debian: apt-get install postgresql)")
    # Not pytest's tmp_path: the server's user could not enter it, and a socket's path must be short.
    folder = Path(tempfile.mkdtemp(prefix="hiprl-pg-"))
    user, group, extra_groups = None, None, None
    if os.geteuid() == 0:  # PostgreSQL refuses to run as root
        names = {account.pw_name for account in pwd.getpwall()}
        account = pwd.getpwnam("postgres" if "postgres" in names else "nobody")
        user, group, extra_groups = account.pw_uid, account.pw_gid, []
        os.chown(folder, user, group)
    log = folder / "log"

    def run(program: str, *arguments: str) -> None:
        command = [str(programs / program), "-D", str(folder / "data"), *arguments]
        done = subprocess.run(
            command,
            cwd=folder,
            user=user,
            group=group,
            extra_groups=extra_groups,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            logged = log.read_text() if log.exists() else ""
            raise RuntimeError(f"{program} failed:\n{done.stdout}{done.stderr}{logged}")

    try:
        run("initdb", "-U", "hiprl", "-A", "trust", "-E", "UTF8", "--no-locale", "--no-sync")
        # No fsync: these databases need not outlive a power cut.
        run("pg_ctl", "-w", "-l", str(log), "-o", f"-F -k {folder} -c listen_addresses=''", "start")
        try:
            yield folder
        finally:
            run("pg_ctl", "-w", "-m", "fast", "stop")
    finally:
        shutil.rmtree(folder, ignore_errors=True)


database_numbers = itertools.count()


@pytest.fixture
def postgres_url(postgres_folder: Path) -> Iterator[str]:
    """URL of an empty database, for this test alone."""
    psycopg = pytest.importorskip("psycopg", reason="psycopg is not here (pip install 'hiprl[postgres]')")
    name = f"test_{next(database_numbers)}"
    socket = str(postgres_folder)
    with psycopg.connect(host=socket, user="hiprl", dbname="postgres", autocommit=True) as server:
        server.execute(f"CREATE DATABASE {name} TEMPLATE template0")
        yield f"postgresql+psycopg://hiprl@/{name}?host={socket}"
        server.execute(f"DROP DATABASE {name} WITH (FORCE)")


def left_out_because(report: pytest.TestReport | pytest.CollectReport) -> str:
    """The reason that a skipped test gave."""
    why = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    return why.removeprefix("Skipped: ")


def insist(report: pytest.TestReport | pytest.CollectReport) -> None:
    """Under HIPRL_REQUIRE_ALL, leaving a test out is failing it."""
    if REQUIRE_ALL and report.skipped and not hasattr(report, "wasxfail"):
        report.longrepr = f"left out, which HIPRL_REQUIRE_ALL forbids: {left_out_because(report)}"
        report.outcome = "failed"


# The first of the wrappers is the last to touch the report: what was expected to fail is marked by then.
@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Look at each test's report."""
    report = yield
    insist(report)
    return report


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Look at each file's report: a whole file can be left out."""
    report = yield
    insist(report)
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say what was left out, and why."""
    reasons = Counter(left_out_because(report) for report in terminalreporter.stats.get("skipped", []))
    if reasons:
        terminalreporter.section("left out")
    for why, count in reasons.items():
        terminalreporter.write_line(f"{count} x {why}")
