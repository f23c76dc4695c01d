"""Fixtures of the tests of the repository: its documentation, examples, images and the tools of its makers."""

from extra_messages import more_messages, with_more_messages

__all__ = ["more_messages", "with_more_messages"]
