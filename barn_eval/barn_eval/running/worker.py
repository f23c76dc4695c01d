"""A worker process: it runs jobs until it is told to end or its parent is gone.

`python -m barn_eval.running.worker FD NAME` starts it; FD is a socket to the parent,
which sends the work and then the jobs. The worker imports nothing of the user's main
script: cloudpickle sends what the script defines by value.
"""

import os
import select
import signal
import sys
import threading
import time
from contextlib import suppress
from multiprocessing.connection import Connection
from types import FrameType

from barn_eval.running.pool import JobRefusal, Report, Work, run_job
from barn_worlds.base.garbage import reduce_garbage_collection

GRACE_S = 20.0
"""Time that a worker has to end its ROS nodes before it is killed [s]."""


def serve(connection: Connection, name: str) -> None:
    """Run jobs that a socket sends and send reports back until it sends None or closes.

    Args:
        connection: Socket to the parent.
        name: Name of the worker in reports.
    """
    # A terminal sends these signals to all processes; the parent decides what they end.
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, signal.SIG_IGN)
    # The parent has blocked it for the start of this process.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    signal.signal(signal.SIGTERM, _exit)
    threading.Thread(
        target=_end_with_parent, args=(connection.fileno(),), daemon=True
    ).start()

    work: Work | None = None
    problem = ""
    try:
        try:
            work = connection.recv()
        # Unpickling imports the planners' modules, which may raise anything.
        except Exception as error:
            problem = (
                "planners cannot be loaded in a worker:"
                f" {type(error).__name__}: {error}"
            )
        while (message := connection.recv()) is not None:
            key, job = message
            report: Report = JobRefusal(key, name, problem)
            if work is not None:
                report = run_job(work, key, name, job, connection.send)
            connection.send(report)
    except (EOFError, OSError):
        # The parent is gone, or a planner closed the connection.
        return
    except KeyboardInterrupt:
        # A planner raised it: the signal itself is ignored.
        sys.exit(1)
    finally:
        if work is not None:
            work.close()
        with suppress(OSError):
            connection.close()


def _exit(_signal: int, _frame: FrameType | None) -> None:
    """Handle SIGTERM: exit with code 143, so that `finally` ends the ROS nodes."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    # Finalizers of objects that are only half constructed by now would complain.
    sys.unraisablehook = lambda _: None
    raise SystemExit(128 + signal.SIGTERM)


def _end_with_parent(descriptor: int) -> None:
    """Wait until the parent closes the socket; end this worker, by force after 20 s.

    `descriptor` is the socket's file descriptor. A running job is interrupted, too.
    """
    poll = select.poll()
    # No events asked for: only a hang-up ends the wait, and a job stays unread.
    poll.register(descriptor, 0)
    poll.poll()
    os.kill(os.getpid(), signal.SIGTERM)
    # The signal ends ROS nodes in order. A job that ignores it ends here.
    time.sleep(GRACE_S)
    os._exit(1)


if __name__ == "__main__":
    reduce_garbage_collection()
    serve(Connection(int(sys.argv[1])), sys.argv[2])
