"""A worker process: does jobs until it is told to end, or the process that started it is gone.

Started by its path as `python worker.py FD`, FD being a socket to that process, over which come the import path, the
work, and jobs. So nothing of the user's main script is imported; what it defines comes along by value (cloudpickle).
"""

import sys

if __name__ == "__main__":
    sys.path.pop(0)  # this folder, whose modules are not to be found by their short names

import os
import select
import signal
import threading
import time
from contextlib import suppress
from multiprocessing.connection import Connection

# Time that workers have to end what they have started (nodes of ROS trials) before they are killed.
GRACE_S = 20.0


def serve(connection: Connection) -> None:
    """Do jobs until None comes, or the parent is gone."""
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT):  # these reach all processes; the parent decides
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    signal.signal(signal.SIGTERM, _exit)
    threading.Thread(target=_outlive_no_parent, args=(connection.fileno(),), daemon=True).start()
    work = None
    try:
        sys.path[:] = connection.recv()
        from barn_eval.experiments.engine import attempt  # noqa: PLC0415 (found by the path that has just come)

        try:
            work = connection.recv()
        except Exception as error:  # whatever the planners' modules do when they are imported
            _refuse(connection, f"planners cannot be loaded in a worker: {type(error).__name__}: {error}")
            return
        while (job := connection.recv()) is not None:
            connection.send(attempt(work, job, connection.send))
    except (EOFError, OSError):
        return  # the parent is gone, or a planner has closed the connection
    except KeyboardInterrupt:
        sys.exit(1)  # raised by a planner: the signal is ignored
    finally:
        if work is not None:
            work.close()
        with suppress(OSError):
            connection.close()


def _refuse(connection: Connection, reason: str) -> None:
    while connection.recv() is not None:
        connection.send(("refused", reason))


def _exit(_signal: int, _frame: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    sys.unraisablehook = lambda _: None  # of finalisers of objects that this leaves half made
    raise SystemExit(128 + signal.SIGTERM)


def _outlive_no_parent(descriptor: int) -> None:
    """End this worker, job or not, when the parent has been killed, which closes its end of the socket."""
    hung_up = select.poll()
    hung_up.register(descriptor, 0)
    hung_up.poll()
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(GRACE_S)
    os._exit(1)


if __name__ == "__main__":
    serve(Connection(int(sys.argv[1])))
