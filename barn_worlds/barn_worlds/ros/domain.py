"""Reserves a ROS domain, so that parallel trials on one host do not interfere."""

import errno
import os
import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from barn_worlds.base.errors import ConfigError

# Domains whose ports lie below the ephemeral ports of Linux. Domain 0 is left for the
# user's other programs.
DOMAINS = range(1, 102)
_LARGEST_DOMAIN = 232
# DDS: domain d has the ports from 7400 + 250 d.
_FIRST_PORT = 7400
_PORTS_PER_DOMAIN = 250


@contextmanager
def reserve_domain(environment: Mapping[str, str]) -> Iterator[int]:
    """Reserve ROS_DOMAIN_ID's domain, or a free one, for a block; ConfigError if taken.

    Args:
        environment: Environment variables.

    Yields:
        The domain.

    Raises:
        ConfigError: If ROS_DOMAIN_ID is no domain, if another run uses it, or if no
            domain is free.
    """
    requested = environment.get("ROS_DOMAIN_ID", "")
    if requested and (not requested.isdecimal() or int(requested) > _LARGEST_DOMAIN):
        raise ConfigError(
            f"ROS_DOMAIN_ID must be from 0 to {_LARGEST_DOMAIN}, got {requested!r}"
        )
    candidates = [int(requested)] if requested else _free_domains()

    # The system releases an abstract socket even if this process is killed.
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as reservation:
        for domain in candidates:
            try:
                reservation.bind(f"\0barn_ros_domain_{domain}")
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise
                continue
            yield domain
            return
    if requested:
        raise ConfigError(
            f"ROS_DOMAIN_ID {requested}: another run uses this domain; "
            "choose another, or leave it unset"
        )
    raise ConfigError(
        f"no free ROS domain among {DOMAINS.start} to {DOMAINS.stop - 1}: "
        "set ROS_DOMAIN_ID"
    )


def is_domain_in_use(domain: int) -> bool:
    """Tell whether any process on this host has a UDP port of a ROS domain open."""
    return domain in _busy_domains()


def _free_domains() -> list[int]:
    """Return the domains in `DOMAINS` without open ports, rotated by process ID."""
    # Runs that start at once would otherwise all try the same domains.
    first = os.getpid() % len(DOMAINS)
    busy = _busy_domains()
    rotation = (*DOMAINS[first:], *DOMAINS[:first])
    return [domain for domain in rotation if domain not in busy]


def _busy_domains() -> set[int]:
    """Return domains that have an open UDP port on this host, whoever opened it."""
    # Programs of other users count as well, so the tables of the kernel are the source.
    domains = set()
    for table in ("/proc/net/udp", "/proc/net/udp6"):
        with suppress(OSError):
            for line in Path(table).read_text("ascii").splitlines()[1:]:
                # The second column is the local address: hexadecimal host:port.
                port = int(line.split()[1].rpartition(":")[2], 16)
                domains.add((port - _FIRST_PORT) // _PORTS_PER_DOMAIN)
    return domains
