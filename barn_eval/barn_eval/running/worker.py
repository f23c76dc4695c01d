"""A worker process: does jobs until it is told to end, or the process that started it is gone.

Started as `python -m barn_eval.running.worker FD NAME`, FD being a socket to that process, over which come the work
and jobs. So nothing of the user's main script is imported; what it defines comes along by value (cloudpickle).
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

from barn_eval.running.engine import Refused, Work, attempt
from barn_worlds.base.garbage import reduce_garbage_collection

# Time that workers have to end what they have started (nodes of ROS trials) before they are killed.
GRACE_S = 20.0


def serve(connection: Connection, name: str) -> None:
    """Do jobs until None comes, or the parent is gone."""
    for number in (
        signal.SIGINT,
        signal.SIGHUP,
        signal.SIGQUIT,
    ):  # these reach all processes; the parent decides
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    signal.signal(signal.SIGTERM, _exit)
    threading.Thread(
        target=_outlive_no_parent, args=(connection.fileno(),), daemon=True
    ).start()
    work: Work | None = None
    problem = ""
    try:
        try:
            work = connection.recv()
        except (
            Exception
        ) as error:  # whatever the planners' modules do when they are imported
            problem = f"planners cannot be loaded in a worker: {type(error).__name__}: {error}"
        while (given := connection.recv()) is not None:
            key, job = given
            connection.send(
                attempt(work, key, name, job, connection.send)
                if work
                else Refused(key, name, problem)
            )
    except (EOFError, OSError):
        return  # the parent is gone, or a planner has closed the connection
    except KeyboardInterrupt:
        sys.exit(1)  # raised by a planner: the signal is ignored
    finally:
        if work is not None:
            work.close()
        with suppress(OSError):
            connection.close()


def _exit(_signal: int, _frame: FrameType | None) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    sys.unraisablehook = lambda _: (
        None
    )  # of finalisers of objects that this leaves half made
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
    reduce_garbage_collection()
    serve(Connection(int(sys.argv[1])), sys.argv[2])
