"""How messages are transformed and converted: a function for each type."""

from copy import deepcopy

from rclpy.duration import Duration
from std_msgs.msg import Header


class TypeException(Exception):
    """No function is registered for a type."""


class NotImplementedException(Exception):
    """A buffer has no such method."""


class TransformRegistration:
    """Functions that transform messages, by type."""

    _functions = {}

    def add(self, key, callback):
        """Register callback(message, transform) for a type."""
        self._functions[key] = callback

    def get(self, key):
        """Return the function of a type."""
        return _find(self._functions, key)


class ConvertRegistration:
    """Functions that convert objects to messages, from messages, and between types."""

    _to_msg = {}
    _from_msg = {}
    _convert = {}

    def add_to_msg(self, key, callback):
        """Register a function from a type to a message."""
        self._to_msg[key] = callback

    def add_from_msg(self, key, callback):
        """Register a function from a message to a type."""
        self._from_msg[key] = callback

    def add_convert(self, key, callback):
        """Register a function between a pair of types."""
        self._convert[key] = callback

    def get_to_msg(self, key):
        """Return the function from a type to a message."""
        return _find(self._to_msg, key)

    def get_from_msg(self, key):
        """Return the function from a message to a type."""
        return _find(self._from_msg, key)

    def get_convert(self, key):
        """Return the function between a pair of types."""
        return _find(self._convert, key)


def _find(functions, key):
    if key not in functions:
        raise TypeException(f"Type {key} is not loaded or supported")
    return functions[key]


def convert(a, b_type):
    """Return an object as another type."""
    registration = ConvertRegistration()
    try:
        return registration.get_convert((type(a), b_type))(a)
    except TypeException:
        if type(a) is b_type:
            return deepcopy(a)
    message = registration.get_to_msg(type(a))(a)
    return registration.get_from_msg(b_type)(message)


def Stamped(obj, stamp, frame_id):
    """Return the object with a header."""
    obj.header = Header(frame_id=frame_id, stamp=stamp)
    return obj


class BufferInterface:
    """Transforms messages with what a buffer knows."""

    def __init__(self):
        """Use the functions that are registered by type."""
        self.registration = TransformRegistration()

    def transform(
        self, object_stamped, target_frame, timeout=Duration(), new_type=None
    ):
        """Return a stamped message in another frame, at its own time."""
        header = object_stamped.header
        transform = self.lookup_transform(
            target_frame, header.frame_id, header.stamp, timeout
        )
        return self._apply(object_stamped, transform, new_type)

    def transform_full(
        self,
        object_stamped,
        target_frame,
        target_time,
        fixed_frame,
        timeout=Duration(),
        new_type=None,
    ):
        """Return a stamped message in another frame at another time."""
        header = object_stamped.header
        transform = self.lookup_transform_full(
            target_frame,
            target_time,
            header.frame_id,
            header.stamp,
            fixed_frame,
            timeout,
        )
        return self._apply(object_stamped, transform, new_type)

    def _apply(self, object_stamped, transform, new_type):
        result = self.registration.get(type(object_stamped))(object_stamped, transform)
        return result if new_type is None else convert(result, new_type)

    def _refuse(self, *_, **__):
        raise NotImplementedException

    lookup_transform = lookup_transform_full = _refuse
    can_transform = can_transform_full = _refuse
