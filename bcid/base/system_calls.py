"""A filter of system calls (seccomp): a process that reads files of others computes and reads, and does nothing else.

libseccomp builds the filter and knows the numbers of the calls; pyseccomp is its binding. What is denied fails with EPERM, for the
process and all of its threads, for good.
"""

from __future__ import annotations

import errno
import os
import sys
from importlib import import_module
from typing import Any

# Sockets of any family, and rings of calls that no filter sees.
_NETWORK = "socket socketpair connect bind listen accept accept4 sendto sendmsg sendmmsg recvfrom recvmsg recvmmsg"
_RINGS = "io_uring_setup io_uring_enter io_uring_register"
# Other programs and processes: to make, signal, trace, read or rule them.
_STARTS = "fork vfork execve execveat"
_OTHERS = (
    "kill tkill rt_sigqueueinfo rt_tgsigqueueinfo pidfd_open pidfd_getfd pidfd_send_signal ptrace process_vm_readv"
)
_OTHERS += " process_vm_writev process_madvise process_mrelease kcmp setsid setpgid setrlimit setpriority ioprio_set"
_OTHERS += " sched_setscheduler sched_setparam sched_setattr migrate_pages move_pages"
_SHARED = "shmget shmat shmctl shmdt msgget msgsnd msgrcv msgctl semget semop semtimedop semctl mq_open mq_unlink"
# The kernel and the machine.
_KERNEL = (
    "bpf perf_event_open userfaultfd keyctl add_key request_key fanotify_init open_by_handle_at personality syslog"
)
_KERNEL += " mount umount umount2 move_mount open_tree fsopen fsconfig fsmount fspick mount_setattr pivot_root chroot"
_KERNEL += " unshare setns reboot init_module finit_module delete_module kexec_load kexec_file_load swapon swapoff acct"
_KERNEL += " sethostname setdomainname settimeofday clock_settime adjtimex clock_adjtime quotactl ioperm iopl"
# Whatever changes files; files that are open for writing stay so.
_FILES = (
    "creat truncate rename renameat renameat2 unlink unlinkat mkdir mkdirat rmdir link linkat symlink symlinkat mknod"
)
_FILES += " mknodat chmod fchmodat fchmodat2 chown lchown fchownat utime utimes futimesat utimensat setxattr lsetxattr"
_FILES += " removexattr lremovexattr setxattrat removexattrat fchmod fchown fsetxattr fremovexattr"
# Memory that no limit counts.
_FILES += " memfd_create memfd_secret"
_DENIED = " ".join((_NETWORK, _RINGS, _STARTS, _OTHERS, _SHARED, _KERNEL, _FILES)).split()
# Calls whose arguments lie in memory, where no filter looks: the C library and Python use others where there are none.
_UNSEEN = ("clone3", "openat2")
_THREAD = 0x00010000
_PARENT_DEATH_SIGNAL = 1
# Requests that change a file that is open for reading (FS_IOC_SETFLAGS, FS_IOC_FSSETXATTR), or type into a terminal
# (TIOCSTI, TIOCLINUX).
_REQUESTS = (0x40086602, 0x401C5820, 0x5412, 0x541C)
_WORD = 0xFFFFFFFF


def seccomp() -> str:
    """Why there is no filter of system calls here; "" where there is one."""
    try:
        _library()
    except (ImportError, RuntimeError, OSError) as error:
        return str(error)
    return ""


def compute_only() -> bool:
    """Give up, for good, all system calls but those for computing, for reading files, and for writing to those that are open.

    Threads may be made; processes may not. Returns whether the filter is in place: False without libseccomp.
    """
    try:
        library = _library()
        rules = library.SyscallFilter(library.ALLOW)
        _deny(library, rules)
        rules.set_attr(library.Attr.CTL_TSYNC, 1)
        rules.load()
    except (ImportError, RuntimeError, OSError):
        return False
    return True


def _deny(library: Any, rules: Any) -> None:
    """Add the rules. Names that this libseccomp or processor does not know are numbered below zero: there is no such call."""
    refused = library.ERRNO(errno.EPERM)

    def deny(name: str, *when: Any, action: int = refused) -> None:
        if library.resolve_syscall(library.Arch.NATIVE, name) >= 0:
            rules.add_rule(action, name, *when)

    def masked(argument: int, mask: int, value: int) -> Any:
        return library.Arg(argument, library.MASKED_EQ, mask, value)

    def differs(argument: int, value: int) -> Any:
        return library.Arg(argument, library.NE, value)

    for name in _DENIED:
        deny(name)
    for name in _UNSEEN:
        deny(name, action=library.ERRNO(errno.ENOSYS))
    deny("clone", masked(0, _THREAD, 0))
    # The C library ends a process by a signal to itself.
    deny("tgkill", differs(0, os.getpid()))
    # Limits of this process may be asked for.
    deny("prlimit64", differs(0, 0))
    deny("prlimit64", differs(2, 0))
    deny("prctl", masked(0, _WORD, _PARENT_DEATH_SIGNAL))
    for request in _REQUESTS:
        deny("ioctl", masked(1, _WORD, request))
    for name, flags in (("open", 1), ("openat", 2)):
        for how in (os.O_WRONLY, os.O_RDWR):
            deny(name, masked(flags, os.O_ACCMODE, how))
        for how in (os.O_CREAT, os.O_TRUNC):
            deny(name, masked(flags, how, how))


def _library() -> Any:
    """The binding; `RuntimeError` where libseccomp is not there, or is not for this system."""
    if sys.platform != "linux":
        raise RuntimeError("not on this system")
    return import_module("pyseccomp")
