"""The process behind a `BackgroundSolver`, which hands it the descriptor of a connection."""

from __future__ import annotations

import os
import sys
import traceback
from contextlib import suppress
from multiprocessing.connection import Connection
from queue import SimpleQueue
from threading import Thread
from typing import Any

from dpc_ros.control.online import load_system
from dpc_ros.control.solver import SolverHere
from dpc_ros.threads import single_threaded_algebra

_NICENESS = 10  # below the nodes of the loop, once it runs


def main() -> None:
    """Answer questions until the other end of the connection is closed."""
    connection: Connection[Any, Any] = Connection(int(sys.argv[1]))
    received: SimpleQueue[Any] = SimpleQueue()
    Thread(target=_receive, args=(connection, received), daemon=True).start()
    single_threaded_algebra()
    _, _, system = load_system(received.get())
    solver = SolverHere(system)
    is_waited_for = True  # by a node that can't begin without its first target
    with suppress(OSError):  # nobody is there any more
        while True:
            question = received.get()
            solver.ask(question)
            answer = solver.wait()
            if is_waited_for and question.target is not None:
                is_waited_for = False
                os.nice(_NICENESS)
            try:
                connection.send((answer.solution, answer.problem))
            except OSError:
                raise
            except Exception as error:  # whatever can't be pickled of a law that is not ours
                connection.send((None, f'expected a solution that can be pickled: {error}'))


def _receive(connection: Connection[Any, Any], received: SimpleQueue[Any]) -> None:
    """Hand over what comes; end the process with the connection, whatever it is doing."""
    try:
        while True:
            received.put(connection.recv())
    except (EOFError, OSError):
        pass
    except Exception:  # whatever can't be unpickled of a law that is not ours
        traceback.print_exc()
    finally:
        os._exit(0)


if __name__ == '__main__':
    main()
