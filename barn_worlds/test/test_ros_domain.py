"""Domains for trials and tests that run side by side."""

import socket

import pytest

from barn_worlds.base.errors import ConfigError
from barn_worlds.ros.domain import DOMAINS, reserved_domain


def test_domains_side_by_side_differ(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with reserved_domain({}) as first, reserved_domain({}) as second:
        assert first != second
        assert {first, second} <= set(DOMAINS)
    with reserved_domain({}) as again:
        assert again == first


def test_the_users_own_domain_is_respected():
    with reserved_domain({"ROS_DOMAIN_ID": "42"}) as number:
        assert number == 42
    with (
        pytest.raises(ConfigError, match="ROS_DOMAIN_ID must be from 0 to 232, got 'x'"),
        reserved_domain({"ROS_DOMAIN_ID": "x"}),
    ):
        pass


def test_two_campaigns_on_one_domain(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    asked = {"ROS_DOMAIN_ID": "42"}
    with (
        reserved_domain(asked),
        pytest.raises(ConfigError, match=r"^ROS_DOMAIN_ID 42: another run uses this domain; choose another, or leave "),
        reserved_domain(asked),
    ):
        pass
    with reserved_domain(asked) as number:
        assert number == 42


def test_domain_with_listeners_is_not_taken(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with reserved_domain({}) as number:
        pass
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 7400 + 250 * number + 10))
        with reserved_domain({}) as other:
            assert other != number
