"""The sandbox of the reader of uploads: rights that its process gives up before it reads, by system
calls.

``python -m isogi_server.uploads.sandbox`` tries it, and prints as JSON the protections that this
system lacks.
"""

import ctypes
import errno
import json
import os
import platform
import struct
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

NOBODY_ID = 65534
"""User and group that the reader takes if it was started as root."""


class Machine(NamedTuple):
    """A processor architecture: its number in <linux/audit.h>, the number of seccomp(2), and
    its column in ALLOWED_CALLS.
    """

    audit: int
    seccomp: int
    column: int


SECCOMP_MACHINES = {"x86_64": Machine(0xC000003E, 317, 0), "aarch64": Machine(0xC00000B7, 277, 1)}

ALLOWED_CALLS = {
    "brk": (12, 214),
    "clock_gettime": (228, 113),
    "clock_nanosleep": (230, 115),
    "close": (3, 57),
    "exit": (60, 93),
    "exit_group": (231, 94),
    "fdatasync": (75, 83),
    "fstat": (5, 80),
    "fsync": (74, 82),
    "ftruncate": (77, 46),
    "futex": (202, 98),
    "getpid": (39, 172),
    "getrandom": (318, 278),
    "getrusage": (98, 165),
    "gettid": (186, 178),
    "gettimeofday": (96, 169),
    "lseek": (8, 62),
    "madvise": (28, 233),
    "mmap": (9, 222),
    "mprotect": (10, 226),
    "mremap": (25, 216),
    "munmap": (11, 215),
    "nanosleep": (35, 101),
    "newfstatat": (262, 79),
    "pread64": (17, 67),
    "pwrite64": (18, 68),
    "read": (0, 63),
    "readv": (19, 65),
    "restart_syscall": (219, 128),
    "rt_sigaction": (13, 134),
    "rt_sigprocmask": (14, 135),
    "rt_sigreturn": (15, 139),
    "sched_getaffinity": (204, 123),
    "sched_yield": (24, 124),
    "sigaltstack": (131, 132),
    "sysinfo": (99, 179),
    "write": (1, 64),
    "writev": (20, 66),
}
"""The system calls that the reader needs once all files are open, with their numbers on each
architecture.
"""

NO_NEW_PRIVILEGES = 38
"""PR_SET_NO_NEW_PRIVS of <linux/prctl.h>: the kernel lets processes without root confine
themselves only with it.
"""

SECCOMP_FILTER = 1
ALL_THREADS = 1
"""SECCOMP_SET_MODE_FILTER, and its flag that includes threads that run already."""

LOAD_WORD = 0x20
JUMP_IF_EQUAL = 0x15
RETURN_ANSWER = 0x06
"""Codes of BPF instructions: load a word of the call's data, jump if it equals a number, return
an answer.
"""

ALLOW_CALL = 0x7FFF0000
REFUSE_CALL = 0x00050000 | errno.EPERM

CREATE_RULESET = 444
RESTRICT_SELF = 446
"""System calls of Landlock, with the same numbers on all architectures."""

LANDLOCK_RIGHTS = {1: 13, 2: 14, 3: 15, 5: 16}
"""Numbers of file rights that Landlock handles, by the first version of its interface that has
as many.
"""


def confine() -> list[str]:
    """Give up files, sockets, processes and signals, except for open descriptors; return the names
    of protections that this system lacks.

    Protections are independent: if one is missing, the others hold.
    """
    lacking = []
    # From the outside in: become nobody while calls are still allowed, and give up calls last.
    for name, protect in {
        "another user": become_nobody,
        "Landlock": give_up_paths,
        "seccomp": give_up_calls,
    }.items():
        try:
            protect()
        except (AttributeError, KeyError, OSError):
            lacking.append(name)
    return lacking


def become_nobody() -> None:
    """Become the user and group NOBODY_ID if this is root. Raises OSError."""
    if os.geteuid() == 0:
        os.setgroups([])
        os.setresgid(NOBODY_ID, NOBODY_ID, NOBODY_ID)
        os.setresuid(NOBODY_ID, NOBODY_ID, NOBODY_ID)


def give_up_paths() -> None:
    """Give up opening, creating, renaming and removing files by path, by Landlock; and, if it can,
    binding, connecting and signalling.

    Raises OSError if the kernel has no Landlock.
    """
    version = call(CREATE_RULESET, None, 0, 1)
    files = max(count for since, count in LANDLOCK_RIGHTS.items() if since <= version)
    # Handle all rights that this version knows, and allow none of them: files, network (version 4),
    # sockets and signals (version 6).
    handled = (1 << files) - 1, 3 if version >= 4 else 0, 3 if version >= 6 else 0
    rules = call(CREATE_RULESET, struct.pack("QQQ", *handled), 24, 0)
    try:
        refuse_privileges()
        call(RESTRICT_SELF, rules, 0)
    finally:
        os.close(rules)


def give_up_calls() -> None:
    """Refuse all system calls but those in ALLOWED_CALLS, by seccomp.

    Raises OSError if the kernel has no seccomp, and KeyError on an unknown architecture.
    """
    machine = SECCOMP_MACHINES[platform.machine()]
    steps = filter_of(machine)
    code = ctypes.create_string_buffer(steps)
    refuse_privileges()
    call(
        machine.seccomp,
        SECCOMP_FILTER,
        ALL_THREADS,
        struct.pack("HP", len(steps) // 8, ctypes.addressof(code)),
    )


def filter_of(machine: Machine) -> bytes:
    """Return the BPF program: refuse calls of another architecture, allow those that are
    needed, refuse the rest.
    """
    numbers = [row[machine.column] for row in ALLOWED_CALLS.values()]
    count = len(numbers)
    # Jumps are relative to the next step. The last two steps refuse and allow.
    steps = [
        (LOAD_WORD, 0, 0, 4),
        (JUMP_IF_EQUAL, 0, count + 1, machine.audit),
        (LOAD_WORD, 0, 0, 0),
    ]
    steps += [(JUMP_IF_EQUAL, count - index, 0, number) for index, number in enumerate(numbers)]
    return b"".join(
        struct.pack("HBBI", *step)
        for step in [*steps, (RETURN_ANSWER, 0, 0, REFUSE_CALL), (RETURN_ANSWER, 0, 0, ALLOW_CALL)]
    )


def refuse_privileges() -> None:
    """Gain no rights from now on by executing programs. Raises OSError."""
    checked(ctypes.CDLL(None, use_errno=True).prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0))


def call(number: int, *arguments: int | bytes | None) -> int:
    """Return the result of a system call. Raises OSError if it fails, or if the system is not
    Linux.
    """
    if sys.platform != "linux":
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
    words = [ctypes.c_long(each) if isinstance(each, int) else each for each in arguments]
    return checked(ctypes.CDLL(None, use_errno=True).syscall(ctypes.c_long(number), *words))


def checked(answer: int) -> int:
    """Return the result of a call. Raises OSError if it is negative."""
    if answer < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return answer


def lacking() -> str:
    """Return a sentence that names the protections that this system lacks; empty if it has all.
    Blocks until a child process has tried them.
    """
    trial = [sys.executable, "-P", "-m", "isogi_server.uploads.sandbox"]
    given = {"PYTHONPATH": str(Path(__file__).resolve().parents[2]), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(trial, cwd="/", env=given, capture_output=True, check=False)
    if done.returncode == 0:
        names = json.loads(done.stdout)
    else:
        names = ["Landlock", "seccomp"]
    if names:
        return f"Uploads are read without {' and '.join(names)}: this system refuses that."
    return ""


if __name__ == "__main__":
    print(json.dumps(confine()))  # noqa: T201
