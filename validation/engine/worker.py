"""A child process that makes trials: ``python -m validation.engine.worker PIPE``; see `validation.engine.workers`.

Standard input: a line that tells the work, then a line for each task, `[name, task]`. Each is answered on the pipe, a number, by a
line: `""`, or why the machine cannot do it.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import sys
import threading
from pathlib import Path

from bcid.base.errors import MachineError
from validation.engine.dispatch import attempt
from validation.engine.work import Work


def main(pipe: int) -> None:
    """Make trials until the input ends; it ends when the parent does."""
    lines: queue.Queue[bytes] = queue.Queue()
    threading.Thread(target=_listen, args=(lines,), daemon=True).start()
    about = json.loads(lines.get())
    work = Work(about["maker"], about["job"], Path(about["results"]))
    while True:
        name, task = json.loads(lines.get())
        reason = ""
        try:
            attempt(work, name, task)
        except MachineError as error:
            reason = str(error)
        os.write(pipe, json.dumps(reason).encode() + b"\n")


def _listen(lines: queue.Queue[bytes]) -> None:
    for line in sys.stdin.buffer:
        lines.put(line)
    # The parent is gone: end this process, and all it has started.
    os.killpg(os.getpgid(0), signal.SIGKILL)


if __name__ == "__main__":
    main(int(sys.argv[1]))
