"""./dev with fakes instead of mmdebstrap, bubblewrap and Python, so that what can go wrong can be made to; tasks; the doctor."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from bcid.app import doctor

ROOT = Path(__file__).resolve().parents[2]

# What ./dev may use of the machine. Everything else is not found, above all apt-get.
TOOLS = [
    *("awk", "bash", "basename", "cat", "chmod", "cut", "date", "df", "dirname", "du", "env", "flock", "grep", "head"),
    *("id", "ls", "mkdir", "mktemp", "mv", "paste", "readlink", "rm", "sed", "sha256sum", "sleep", "sort", "tail"),
    *("tar", "touch", "true", "uname", "xargs"),
]

MMDEBSTRAP = r"""
[ "$1" != --unshare-helper ] || exec "${@:2}"
echo "$BASHPID" >>"$FAKES/mmdebstrap.pids"
case ${FAKE:-} in
network) echo "E: Could not resolve 'deb.debian.org'" >&2; exit 1 ;;
full) echo "tar: usr/lib/x.so: Cannot write: No space left on device" >&2; exit 1 ;;
broken) echo "E: something else" >&2; exit 25 ;;
hang) sleep 60 ;;
slow) sleep 1 ;;
esac
root=${*: -2:1}
[ "$root" != - ] || root=$(mktemp -d)
mkdir -p "$root"/etc/ssl/certs "$root"/usr/bin "$root"/var/lib/dpkg
case $* in *--mode=unshare*) tar -C "$root" -c . && rm -r "$root" ;; esac
"""

BWRAP = r"""
printf '%s\n' "$@" >"$FAKES/bwrap.words"
case $* in
*make_venv.sh*)
    [ "${FAKE:-}" = pip ] || exit 0
    echo "OSError: [Errno 28] No space left on device"
    exit 1 ;;
esac
for a in "$@"; do case $a in --) break ;; esac; shift; done
[ $# -gt 0 ] || exit 0  # the trial whether namespaces can be made
shift
# As bubblewrap: CMD is the child of a process that is number 1, and both of these ignore signals.
bash -c '"$@" <&0 & wait $!' init env --default-signal=INT,TERM,HUP "$@" <&0 &
wait $!
"""

# A Python that has DOLFINx: it makes venvs of itself, and says what it is to run.
PYTHON = r"""
case $* in
*/probe.py) echo "own /usr 3.13" ;;
"-m venv "*)
    mkdir -p "${@: -1}/bin"
    cat "$0" >"${@: -1}/bin/python"
    chmod +x "${@: -1}/bin/python" ;;
*sysconfig*) echo "${0%/bin/python}" ;;
"-m pip install "*) printf '#!%s\n' "$0" >"${0%/python}/tool" ;;
"-P -m "*) echo "$0 runs $3 for ${@:4}" ;;
esac
"""

FAKES = {
    "mmdebstrap": MMDEBSTRAP,
    "bwrap": BWRAP,
    "unshare": 'while [ "${1#--}" != "$1" ]; do shift; done; exec "$@"',
    "newuidmap": "",
    "getsubids": "",
    "python3": "exit 1",
}

pytestmark = pytest.mark.skipif(
    not Path("/usr/share/keyrings/debian-archive-keyring.gpg").exists(), reason="needs Debian's keys, as ./dev does"
)


class Dev:
    """A clone with its own cache, on a machine that has only TOOLS and the fakes."""

    def __init__(self, folder: Path, clone: str = "clone") -> None:
        self.folder = folder
        self.clone = folder / clone
        self.cache = folder / "cache"
        self.fakes = folder / "bin"
        (self.clone / "environment").mkdir(parents=True)
        shutil.copy(ROOT / "dev", self.clone)
        for file in (*ROOT.glob("environment/*.sh"), *ROOT.glob("environment/*.py")):
            shutil.copy(file, self.clone / "environment")
        (self.clone / "environment/debian.txt").write_text("# comment\npython3-dolfinx\n")
        (self.clone / "environment/wheels.txt").write_text("pytest==1\n")
        (self.clone / "environment/solver.txt").write_text("dolfinx==1\n")
        if not self.fakes.exists():
            self.fakes.mkdir()
            for tool in TOOLS:
                found = shutil.which(tool)
                assert found, f"{tool} is needed by ./dev"
                (self.fakes / tool).symlink_to(found)
            for name, text in FAKES.items():
                self.fake(name, text)
        home = folder / "home"
        home.mkdir(exist_ok=True)
        self.env = {
            "PATH": str(self.fakes),
            "HOME": str(home),
            "BCID_CACHE": str(self.cache),
            "BCID_ENV": "tree",
            "TMPDIR": str(folder),
            "FAKES": str(self.folder),
        }

    def fake(self, name: str, text: str) -> None:
        path = self.fakes / name
        path.unlink(missing_ok=True)
        path.write_text(f"#!/usr/bin/env bash\n{text}\n")
        path.chmod(0o755)

    def start(self, *args: str, **env: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [str(self.clone / "dev"), *args],
            env=self.env | env,
            cwd=self.clone,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def __call__(self, *args: str, **env: str) -> tuple[int, str, str]:
        process = self.start(*args, **env)
        out, err = process.communicate(timeout=30)
        return process.returncode, out, err

    @property
    def builds(self) -> list[int]:
        """The process ids of all that mmdebstrap was started with."""
        pids = self.folder / "mmdebstrap.pids"
        return [int(pid) for pid in pids.read_text().split()] if pids.exists() else []

    def made(self, what: str) -> list[str]:
        return sorted(path.name for path in self.cache.glob(f"{what}-*"))

    def wait_for_build(self, number: int = 1) -> None:
        wait_until(lambda: len(self.builds) >= number)


def wait_until(condition, seconds: float = 10) -> None:  # type: ignore[no-untyped-def]
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.02)


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.fixture
def dev(tmp_path: Path) -> Iterator[Dev]:
    dev = Dev(tmp_path / "with space")
    yield dev
    for pid in dev.builds:
        if alive(pid):
            os.kill(pid, signal.SIGKILL)


def test_builds_once_and_is_then_quiet(dev: Dev) -> None:
    code, out, err = dev("bash", "-c", "echo hello; exit 7")
    assert (code, out) == (7, "hello\n"), err
    assert "private Debian trixie tree" in err
    code, out, err = dev("bash", "-c", "echo hello; exit 7")
    assert (code, out, err) == (7, "hello\n", "")
    assert len(dev.builds) == 1
    assert not list(dev.cache.glob("*.partial"))


def test_environment_of_the_command(dev: Dev) -> None:
    show = "echo ${PYTHONPATH-unset} ${LD_PRELOAD-unset} $BCID_PROJECT $OMP_NUM_THREADS $http_proxy"
    given = {"PYTHONPATH": "/x", "LD_PRELOAD": "", "OMP_NUM_THREADS": "2", "http_proxy": "http://p"}
    code, out, err = dev("bash", "-c", show, **given)
    assert (code, out) == (0, f"unset unset {dev.clone} 2 http://p\n"), err
    assert dev("bash", "-c", "echo $OMP_NUM_THREADS")[1] == "1\n"


def test_clones_share_and_lists_decide(dev: Dev) -> None:
    assert dev("true")[0] == 0
    other = Dev(dev.folder, "other")
    code, out, _ = other("bash", "-c", "echo $BCID_PROJECT")
    assert (code, out.strip()) == (0, str(other.clone))
    (dev.clone / "environment/debian.txt").write_text("python3-dolfinx # another comment\n")
    assert dev("true")[0] == 0
    assert (len(dev.made("tree")), len(dev.made("venv"))) == (1, 1)
    (dev.clone / "environment/wheels.txt").write_text("pytest==2\n")
    assert dev("true")[0] == 0
    assert (len(dev.made("tree")), len(dev.made("venv"))) == (1, 2)
    (dev.clone / "environment/debian.txt").write_text("python3-dolfinx\ngcc\n")
    assert dev("true")[0] == 0
    assert dev("--suite", "sid", "true")[0] == 0
    assert (len(dev.made("tree")), len(dev.made("venv"))) == (3, 4)


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("network", "for lack of network: E: Could not resolve 'deb.debian.org'"),
        ("full", "the disk filled up while making the Debian tree"),
        ("broken", "E: something else"),
        ("pip", "the disk filled up while making the venv"),
    ],
)
def test_failed_build_says_why_and_leaves_nothing(dev: Dev, fault: str, expected: str) -> None:
    code, out, err = dev("echo", "hello", FAKE=fault)
    assert (code, out) == (3, "")
    assert expected in err
    log = Path(err.split("Log: ")[1].strip())
    assert log.is_file()
    assert not list(dev.cache.glob("*.partial"))
    assert not dev.made("venv")
    assert dev("echo", "hello")[:2] == (0, "hello\n")


def test_too_little_space_is_said_before_anything_is_done(dev: Dev) -> None:
    dev.fake("df", "echo head; echo disk 1000 900 100 90% /")
    code, _, err = dev("true")
    assert code == 3
    assert "4300 MB are needed" in err
    assert "100 MB are free" in err
    assert not dev.builds


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_interrupted_build(dev: Dev, number: signal.Signals) -> None:
    process = dev.start("true", FAKE="hang")
    dev.wait_for_build()
    process.send_signal(number)
    _, err = process.communicate(timeout=10)
    assert process.returncode == 128 + number
    assert "nothing half-built was kept" in err
    assert not list(dev.cache.glob("*.partial"))
    # A process that was told to end needs a moment on a busy machine, as after a kill.
    wait_until(lambda: not any(map(alive, dev.builds)), 5)
    assert dev("true")[0] == 0


def test_killed_build_leaves_no_process_and_the_next_one_succeeds(dev: Dev) -> None:
    process = dev.start("true", FAKE="hang")
    dev.wait_for_build()
    process.kill()
    process.wait()
    wait_until(lambda: not any(map(alive, dev.builds)), 5)
    assert list(dev.cache.glob("*.partial"))
    code, out, err = dev("echo", "hello")
    assert (code, out) == (0, "hello\n"), err
    assert not list(dev.cache.glob("*.partial"))


def test_two_at_once(dev: Dev) -> None:
    first = dev.start("echo", "one", FAKE="slow")
    dev.wait_for_build()
    code, out, err = dev("echo", "two")
    assert (code, out) == (0, "two\n")
    assert "waiting for it" in err
    assert first.communicate(timeout=10)[0] == "one\n"
    assert len(dev.builds) == 1


def test_the_second_goes_on_when_the_first_is_killed(dev: Dev) -> None:
    first = dev.start("true", FAKE="hang")
    dev.wait_for_build()
    second = dev.start("echo", "two")
    time.sleep(0.3)
    first.kill()
    first.wait()
    out, err = second.communicate(timeout=10)
    assert (second.returncode, out) == (0, "two\n"), err
    assert len(dev.builds) == 2


def test_missing_tools(dev: Dev) -> None:
    (dev.fakes / "mmdebstrap").unlink()
    (dev.fakes / "bwrap").unlink()
    code, _, err = dev("true")
    assert code == 3
    assert "sudo apt-get install mmdebstrap bubblewrap" in err
    assert "Python 3.12 or newer" in err


@pytest.mark.skipif(os.geteuid() != 0, reason="only root installs what is missing")
def test_root_installs_missing_tools(dev: Dev) -> None:
    (dev.fakes / "bwrap").rename(dev.fakes / "not-yet")
    dev.fake("apt-get", '[ "$1" = update ] || { echo "$@" >>"$FAKES/apt"; mv "${0%/*}/not-yet" "${0%/*}/bwrap"; }')
    code, _, err = dev("true")
    assert code == 0, err
    assert "installing bubblewrap" in err
    assert "bubblewrap" in (dev.folder / "apt").read_text()


def test_no_namespaces(dev: Dev) -> None:
    dev.fake("bwrap", "echo 'bwrap: No permissions to create new namespace' >&2; exit 1")
    code, _, err = dev("true")
    assert code == 3
    assert "No permissions to create new namespace" in err
    assert "--privileged" in err


def test_unusable_python(dev: Dev) -> None:
    code, _, err = dev("true", BCID_ENV="auto", BCID_PYTHON="python3")
    assert code == 3
    assert "python3 neither has dolfinx" in err


def test_python_of_the_machine_gets_a_venv_with_the_commands(dev: Dev) -> None:
    dev.fake("python3", PYTHON)
    code, out, err = dev("bcid-validate", "golden", "-o", "RUN", BCID_ENV="host")
    (venv,) = dev.cache.glob("venv-host-*")
    assert (code, out) == (0, f"{venv}/venv/bin/python runs validation for golden -o RUN\n"), err
    assert dev("bcid", "demo", BCID_ENV="")[:2] == (0, f"{venv}/venv/bin/python runs bcid for demo\n")
    # What pip wrote names the Python by the path at which the venv was made.
    assert (venv / "venv/bin/tool").read_text() == f"#!{venv}/venv/bin/python\n"
    assert not dev.builds


def test_inside_of_an_environment_the_command_just_runs(dev: Dev) -> None:
    code, out, err = dev(
        "bash", "-c", "echo $BCID_PROJECT; exit 4", BCID_DEV="another", BCID_ENV="", XDG_CACHE_HOME="/x/cache"
    )
    assert (code, out, err) == (4, f"{dev.clone}\n", "")
    assert not dev.cache.exists()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_signals_reach_the_command_once(dev: Dev, number: signal.Signals) -> None:
    assert dev("true")[0] == 0
    wait = "trap 'echo got; n=1' TERM INT HUP; n=0; echo ready; while [ $n = 0 ]; do sleep 0.1; done; sleep 0.3; exit 9"
    process = dev.start("bash", "-c", wait)
    assert process.stdout
    assert process.stdout.readline() == "ready\n"
    process.send_signal(number)
    out, err = process.communicate(timeout=10)
    assert (process.returncode, out) == (9, "got\n"), err


def test_size_of_dev() -> None:
    def lines(path: Path) -> int:
        return len(path.read_text(encoding="utf-8").splitlines())

    helpers = [path for path in (ROOT / "environment").iterdir() if path.suffix in (".sh", ".py")]
    assert lines(ROOT / "dev") <= 170
    assert lines(ROOT / "dev") + sum(map(lines, helpers)) <= 600


@pytest.mark.skipif("BCID_DEV" not in os.environ, reason="not run in an environment of ./dev")
def test_validation_is_a_command_of_the_environment() -> None:
    run = subprocess.run(["bcid-validate", "--help"], capture_output=True, text=True, cwd="/")
    assert "golden" in run.stdout, run.stderr


class Tasks:
    """environment/tasks.py in a clone, with fakes instead of pytest and mpirun."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "environment").mkdir()
        shutil.copy(ROOT / "environment/tasks.py", folder / "environment")
        for name, text in {"mpirun": MPIRUN, "sleep": "", "python": PYTEST}.items():
            (folder / name).write_text(f"#!/usr/bin/env bash\n{text}\n")
            (folder / name).chmod(0o755)

    def start(self, *args: str, **env: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, str(self.folder / "environment/tasks.py"), *args],
            env=os.environ | {"PATH": f"{self.folder}:{os.environ['PATH']}"} | env,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def __call__(self, *args: str, **env: str) -> tuple[int, str, list[str]]:
        """Exit code, output, and lines of the other output, in which times are t."""
        process = self.start(*args, **env)
        out, err = process.communicate(timeout=60)
        return process.returncode, out, re.sub(r"\d+ s\b", "t", err).splitlines()


# Ranks without MPI, at once.
MPIRUN = """
for ((rank = 0; rank < $2; rank++)); do OMPI_COMM_WORLD_RANK=$rank "${@:3}" & done
code=0
while wait -n; rc=$?; [ $rc != 127 ]; do [ $rc = 0 ] || code=$rc; done
exit $code
"""

# Instead of pytest and coverage: what it is to do, and as which rank.
PYTEST = """
rank=${OMPI_COMM_WORLD_RANK:-serial}
echo "$rank: $*"
case $* in "-m coverage report"*) [ "$BAD" != few ]; exit ;; esac
[ "$rank" != "$BAD" ]
"""


@pytest.fixture
def tasks(tmp_path: Path) -> Tasks:
    tasks = Tasks(tmp_path)
    for folder in ("unit", "verify", "parallel"):
        (tmp_path / "tests" / folder).mkdir(parents=True)
    return tasks


def test_all_tests_are_run_also_on_ranks(tasks: Tasks) -> None:
    code, out, said = tasks("test", BAD="none")
    assert code == 0, out
    passed = ", ".join(f"{name} passed (t)" for name in ("serial", "2 rank(s)", "3 rank(s)", "coverage"))
    assert said[-1] == f"dev: test OK after t: {passed}"
    erased, serial, *ranks, combined, reported = out.splitlines()
    assert erased == "serial: -m coverage erase"
    assert serial.startswith("serial: -m coverage run -m pytest tests/parallel tests/verify tests/unit")
    assert ("-n 2 --dist loadfile" in serial) == (len(os.sched_getaffinity(0)) > 1)
    # Rank 0 of two, and of three: the others are not shown.
    assert [line.split()[0] for line in ranks] == ["0:", "0:"]
    assert all("-m coverage run -m pytest" in line and line.endswith(" tests/parallel") for line in ranks)
    assert combined == "serial: -m coverage combine -q"
    assert reported.startswith("serial: -m coverage report")


def test_too_little_coverage_fails(tasks: Tasks) -> None:
    code, _, said = tasks("test", BAD="few")
    assert code == 1
    assert said[-1].endswith("coverage FAILED (t)")


def test_long_tests_are_run_alone(tasks: Tasks) -> None:
    code, out, said = tasks("test", "--long", "-x", BAD="none")
    assert (code, said[-1]) == (0, "dev: test OK after t: long passed (t)")
    (line,) = out.splitlines()
    assert line.startswith("serial: -m pytest tests/long ")
    assert line.endswith(" -x")


@pytest.mark.parametrize("bad", ["serial", "0", "1"])
def test_failure_of_any_rank_fails(tasks: Tasks, bad: str) -> None:
    code, _, said = tasks("test", "tests/unit/test_a.py", "tests/parallel", "-q", BAD=bad)
    good = [bad != "serial", bad != "0", bad == "serial", bad == "serial"]
    results = [
        f"{name} {'passed' if one else 'FAILED'} (t)"
        for name, one in zip(("serial", "1 rank(s)", "2 rank(s)", "3 rank(s)"), good, strict=True)
    ]
    assert (code, said[-1]) == (1, f"dev: test FAILED after t: {', '.join(results)}")
    # What a rank said that failed and was not shown.
    assert len([line for line in said if line.startswith("rank 1: 1: -m pytest")]) == (2 if bad == "1" else 0)


def test_arguments_go_to_pytest(tasks: Tasks) -> None:
    code, out, _ = tasks("test", "-k", "wrench", BAD="none")
    assert (code, out) == (0, "serial: -m pytest tests/verify tests/unit -k wrench\n")
    code, out, _ = tasks("test", "tests/parallel", "-x", BAD="none")
    assert code == 0
    assert [line.split("thread ")[1] for line in out.splitlines()] == ["tests/parallel -x"] * 3


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_terminated_tests_end_at_once(tasks: Tasks, number: signal.Signals) -> None:
    (tasks.folder / "python").write_text("#!/usr/bin/env bash\n/bin/sleep 0.3\necho $$\nexec /bin/sleep 60\n")
    process = tasks.start("test")
    assert process.stdout
    pid = int(process.stdout.readline())
    process.send_signal(number)
    process.communicate(timeout=10)
    assert process.returncode == 128 + number
    assert not alive(pid)


def test_clean_keeps_what_is_used(dev: Dev) -> None:
    assert dev("true")[0] == 0
    (dev.clone / "environment/debian.txt").write_text("gcc\n")
    # A command in the first environment; then the clone moves on to the second.
    busy = dev.start("--suite", "sid", "bash", "-c", "echo ready; exec sleep 60")
    assert busy.stdout
    assert busy.stdout.readline() == "ready\n"
    assert dev("true")[0] == 0
    assert len(dev.made("tree")) == 3
    code, _, err = dev("clean")
    assert code == 0, err
    assert "in use, kept" in err
    for what in ("tree", "venv", "home"):
        assert [name.split("-")[1] for name in dev.made(what)] == ["sid", "trixie"]
    busy.terminate()
    assert busy.communicate(timeout=10)
    assert dev("true") == (0, "", "")
    assert dev("clean", "--all")[0] == 0
    assert not dev.made("tree")
    assert not dev.made("venv")


def test_commands_write_where_the_user_may_and_not_into_the_environment(dev: Dev) -> None:
    assert dev("true", BCID_WRITE="/nowhere/at/all")[0] == 0
    words = (dev.folder / "bwrap.words").read_text().splitlines()
    bound = {words[i + 1]: word for i, word in enumerate(words) if word in ("--bind", "--bind-try", "--ro-bind")}
    for folder in ("/tmp", "/home", "/root", "/var/tmp", "/srv", str(dev.clone)):
        if Path(folder).is_dir() and not Path(folder).is_symlink():
            assert bound[folder] in ("--bind", "--bind-try"), folder
    for folder in (*dev.cache.glob("tree-*"), *dev.cache.glob("venv-*")):
        assert bound[str(folder)] == "--ro-bind", folder
    assert not {"/usr", "/etc", "/var/lib/dpkg", "/usr/local/lib", "/nowhere/at/all"} & set(bound)


def test_usage(dev: Dev) -> None:
    assert dev("--help")[0] == 0
    assert dev()[0] == 2
    code, _, err = dev("--nonsense", "true")
    assert code == 2
    assert "unknown option --nonsense" in err
    code, _, err = dev("coverage", "--help")
    assert code == 2
    assert "coverage takes no arguments, found '--help'" in err
    assert not dev.builds


def test_slow_blas_is_told_from_a_fast_one() -> None:
    debian = "7f00-7f01 r-xp 00000000 08:01 42                         /usr/lib/x86_64-linux-gnu/{}\n"
    assert doctor.blas_in(debian.format("blas/libblas.so.3.12.1")) == {
        "reference BLAS (/usr/lib/x86_64-linux-gnu/blas/libblas.so.3.12.1)": False
    }
    fast = doctor.blas_in(
        debian.format("openblas-serial/libblas.so.3") + debian.format("openblas-serial/libopenblas-r0.3.29.so")
    )
    assert set(fast.values()) == {True}
    assert doctor.blas_in(debian.format("libc.so.6") + "7f00-7f01 rw-p 00000000 00:00 0 \n") == {}


def test_doctor_survives_a_broken_part(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def check_something() -> doctor.Check:
        raise SystemError("cannot load\nmore")

    good = doctor.Check("good", True, "there")
    minor = doctor.Check("minor", False, "not there", "get it", essential=False)
    monkeypatch.setattr(doctor, "CHECKS", [lambda: good, lambda: minor])
    assert doctor.main() == 0
    assert "get it" in capsys.readouterr().out
    monkeypatch.setattr(doctor, "CHECKS", [check_something, lambda: good])
    assert doctor.main() == 3
    out = capsys.readouterr().out
    assert "SystemError: cannot load" in out
    assert "bcid cannot work here: something" in out


def test_doctor_without_dolfinx() -> None:
    """In a Python without site packages: advice instead of a traceback."""
    python = shutil.which("python3") or "python3"
    run = subprocess.run(
        [python, "-S", "-E", "-c", "from bcid.app.doctor import main; raise SystemExit(main())"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert run.returncode == 3, run.stderr
    assert "WRONG  DOLFINx" in run.stdout
    assert "pip install" in run.stdout
    assert "Traceback" not in run.stderr
