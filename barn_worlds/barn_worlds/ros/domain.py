"""Reserving a ROS domain, so that trials that run side by side on this host do not hear each other."""

import errno
import os
import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from barn_worlds.base.errors import ConfigError

# Domains whose ports lie below the ephemeral ports of Linux; 0 is left for whatever else the user runs.
DOMAINS = range(1, 102)
_FIRST_PORT = 7400  # DDS: domain d has the ports from 7400 + 250 d
_PORTS_PER_DOMAIN = 250


@contextmanager
def reserve_domain(environment: Mapping[str, str]) -> Iterator[int]:
    """Reserve a free domain while the context lasts. If ROS_DOMAIN_ID is set in the environment, it is that one.

    A domain is reserved by an abstract socket of its name; the system releases it even if this process is killed.
    Raises ConfigError if ROS_DOMAIN_ID is not a number, if another run has it, or if no domain is free.
    """
    given = environment.get("ROS_DOMAIN_ID", "")
    if given and (not given.isdecimal() or int(given) > 232):
        raise ConfigError(f"ROS_DOMAIN_ID must be from 0 to 232, got {given!r}")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as name:
        # from one on that differs from process to process
        first, busy = os.getpid() % len(DOMAINS), _busy_domains()
        free = [
            number
            for number in (*DOMAINS[first:], *DOMAINS[:first])
            if number not in busy
        ]
        for number in [int(given)] if given else free:
            try:
                name.bind(f"\0barn_ros_domain_{number}")
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise
                continue
            yield number
            return
    if given:
        raise ConfigError(
            f"ROS_DOMAIN_ID {given}: another run uses this domain; choose another, or leave it unset"
        )
    raise ConfigError(
        f"no free ROS domain among {DOMAINS.start} to {DOMAINS.stop - 1}: set ROS_DOMAIN_ID"
    )


def is_domain_in_use(domain: int) -> bool:
    """Tell whether anybody on this host, of whatever program, takes part in a domain."""
    return domain in _busy_domains()


def _busy_domains() -> set[int]:
    busy = set()
    for table in ("/proc/net/udp", "/proc/net/udp6"):
        with suppress(OSError):
            for line in Path(table).read_text("ascii").splitlines()[1:]:
                port = int(line.split()[1].rsplit(":", 1)[1], 16)
                busy.add((port - _FIRST_PORT) // _PORTS_PER_DOMAIN)
    return busy
