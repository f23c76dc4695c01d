"""Start the nodes of a launch file together, and end when they have ended.

    python start_nodes.py COMMANDS ARGUMENTS...

COMMANDS is a JSON list of commands; each gets the arguments, too. A node that fails ends
the others, as trials need all of them; its exit code is that of this script, which needs
nothing but the standard library.
"""

import json
import os
import signal
import subprocess
import sys


def main(commands: list[list[str]], arguments: list[str]) -> int:
    """Run commands until all end or one fails; end the rest; return its exit code."""
    # Whoever ends this process signals the nodes as well.
    signal.signal(signal.SIGINT, lambda *_: None)
    nodes = [
        subprocess.Popen([*command, *arguments])  # noqa: S603
        for command in commands
    ]
    code = 0
    for _ in nodes:
        _, status = os.wait()
        code = abs(os.waitstatus_to_exitcode(status))
        if code:
            break
    # What is printed ends with the reason, not with the ends of the others.
    for node in nodes:
        node.kill()
    return code


if __name__ == "__main__":
    sys.exit(main(json.loads(sys.argv[1]), sys.argv[2:]))
