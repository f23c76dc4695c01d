"""Domains for trials and tests that run side by side."""

import os
import socket

from refusals import refused

from barn_worlds.ros.domain import DOMAINS, reserve_domain


def test_domains_side_by_side_differ():
    with reserve_domain({}) as first, reserve_domain({}) as second:
        assert first != second
        assert {first, second} <= set(DOMAINS)


def test_the_users_domain_is_respected_and_kept():
    own = 130 + os.getpid() % 100  # none that others choose by themselves
    environment = {"ROS_DOMAIN_ID": str(own)}
    taken = rf"^ROS_DOMAIN_ID {own}: another run uses this domain; choose another, "
    with reserve_domain(environment) as number:
        assert number == own
        with refused(taken), reserve_domain(environment):
            pass
    with reserve_domain(environment) as again:
        assert again == own


def test_a_domain_that_is_no_number_is_one_line():
    message = "ROS_DOMAIN_ID must be from 0 to 232, got 'x'"
    environment = {"ROS_DOMAIN_ID": "x"}
    with refused(message), reserve_domain(environment):
        pass


def test_domain_with_listeners_is_not_taken():
    with reserve_domain({}) as number:
        pass
    port = 7400 + 250 * number + 10
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", port))
        with reserve_domain({}) as other:
            assert other != number
