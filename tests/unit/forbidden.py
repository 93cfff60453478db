"""What a confined process tries, for tests: ``python -m forbidden INSIDE OUTSIDE BARRIERS USER`` prints "TRY: how it ended" lines.

BARRIERS is "both", "landlock" or "seccomp": the other one is as on a machine that has none.
USER is who tries: "root" for who calls, or "ordinary".
"""

from __future__ import annotations

import ctypes
import mmap
import os
import platform
import resource
import signal
import socket
import subprocess
import sys
import sysconfig
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bcid.base import confined, system_calls

ORDINARY = 65534
# System calls that Python has no function for; the numbers of x86_64.
_NUMBERS = {"io_uring_setup": 425, "ptrace": 101, "process_vm_readv": 310, "bpf": 321, "perf_event_open": 298}
_NUMBERS |= {
    "keyctl": 250,
    "userfaultfd": 323,
    "shmget": 29,
    "msgget": 68,
    "semget": 64,
    "open_tree": 428,
    "pidfd_open": 434,
}
_NUMBERS |= {
    "unshare": 272,
    "setns": 308,
    "mount": 165,
    "chroot": 161,
    "tkill": 200,
    "vfork": 58,
    "clone3": 435,
    "openat2": 437,
    "memfd_create": 319,
}


def tries(inside: Path, outside: Path) -> dict[str, Callable[[], Any]]:
    """What is tried, by name."""
    found: dict[str, Callable[[], Any]] = {
        f"socket {family}": lambda family=family: socket.socket(getattr(socket, f"AF_{family}"))
        for family in ("INET", "INET6", "UNIX", "NETLINK")
    }
    found |= {
        "socket UDP": lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM),
        "socketpair": socket.socketpair,
        "fork": _fork,
        "exec": lambda: os.execv(sys.executable, [sys.executable, "-c", ""]),
        "subprocess": lambda: subprocess.run(["/bin/true"], check=True),
        "kill": lambda: os.kill(os.getppid(), 0),
        "kill all": lambda: os.kill(-1, 0),
        "killpg": lambda: os.killpg(os.getppid(), 0),
        "pidfd": lambda: os.pidfd_open(os.getppid()),
        "setsid": os.setsid,
        "setpgid": lambda: os.setpgid(0, 0),
        "prlimit": lambda: resource.prlimit(os.getppid(), resource.RLIMIT_CPU),
        "raise a limit": lambda: resource.prlimit(0, resource.RLIMIT_CORE, (0, 0)),
        "write inside": lambda: (inside / "b").write_text("b"),
        "write outside": lambda: outside.write_text("b"),
        "truncate": lambda: os.truncate(outside, 0),
        "append": lambda: outside.open("ab"),
        "delete": lambda: os.unlink(inside / "a"),
        "make a folder": lambda: (inside / "c").mkdir(),
        "rename": lambda: (inside / "a").rename(inside / "d"),
        "link": lambda: (inside / "e").symlink_to(outside),
        "chmod": lambda: (inside / "a").chmod(0o777),
        "chown": lambda: os.chown(inside / "a", os.getuid(), os.getgid()),
        "times": lambda: os.utime(inside / "a"),
        "read outside": outside.read_bytes,
    }
    numbers = _NUMBERS if platform.machine() == "x86_64" else {}
    return found | {name: lambda number=number: _call(number) for name, number in numbers.items()}


# Of these, what is tried where Landlock stands alone: the others would change this process.
_ALONE = (
    "socket UDP",
    "fork",
    "exec",
    "subprocess",
    "kill",
    "write inside",
    "write outside",
    "truncate",
    "append",
    "delete",
)
_ALONE += ("make a folder", "rename", "link", "read outside")


def _fork() -> None:
    if os.fork() == 0:
        os._exit(0)


def _call(number: int) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    libc.syscall.restype = ctypes.c_long
    if libc.syscall(number, *map(ctypes.c_long, (0,) * 6)) < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def _ended(work: Callable[[], Any]) -> str:
    try:
        work()
    except PermissionError:
        return "refused"
    except OSError as error:
        return f"failed {error.errno}"
    return "done"


def _allowed(inside: Path) -> str:
    """What a reader needs: files of its folder, memory, threads, and to end itself."""
    (inside / "a").read_bytes()
    mmap.mmap(-1, 1 << 20)
    seen: list[int] = []
    thread = threading.Thread(target=lambda: seen.append(1))
    thread.start()
    thread.join()
    signal.raise_signal(0)
    return "done" if seen else "no thread"


def main() -> None:
    """Confine this process as the arguments say, try everything, and abort."""
    inside, outside = Path(sys.argv[1]), Path(sys.argv[2])
    barriers, user = sys.argv[3:]
    if barriers == "landlock":
        confined.compute_only = lambda: False
    if barriers == "seccomp":
        confined.read_only = lambda _: False
    if user == "ordinary":
        system_calls.seccomp()
        sysconfig.get_paths()
        os.setgroups([])
        os.setgid(ORDINARY)
        os.setuid(ORDINARY)
    held = confined.confine([inside])
    print(f"barriers: {held}")
    print(f"allowed: {_allowed(inside) if held[1] else 'done'}", flush=True)
    for name, work in tries(inside, outside).items():
        if barriers == "landlock" and name not in _ALONE:
            continue
        print(f"{name}: {_ended(work)}", flush=True)
    os.abort()


if __name__ == "__main__":
    main()
