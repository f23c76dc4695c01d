"""Poses of models, links, collisions and frames in SDF.

They follow the rules of SDF 1.7 and later, which also apply to earlier releases:
http://sdformat.org/tutorials?tut=pose_frame_semantics
"""

from collections.abc import Iterator
from xml.etree.ElementTree import Element

import numpy as np

from barn_worlds.base.errors import WorldError, read_numbers, suggest
from barn_worlds.geometry.transform import Transform, quaternion_matrix, rotation_matrix

_SCOPES = {"world": "world", "model": "__model__"}  # name of its own frame, by tag
_FRAMES = ("frame", "joint", "link", "model")
_NUMBERS = {"euler_rpy": 6, "quat_xyzw": 7}
_SEPARATOR = "::"


class Scope:
    """A world or a model, which gives names a meaning and a pose in the world.

    Methods raise WorldError for invalid poses and unknown names or names given twice.
    """

    def __init__(self, element: Element, where: str, pose: Transform, state: Element):
        """Index the elements and saved states of a <world> or <model> by name.

        Args:
            element: The <world> or <model>.
            where: Path of the file and name of the model, to begin messages with.
            pose: Pose of its own frame in the world.
            state: Part of the world's <state>, in which Gazebo Classic saves poses of
                models and links, for this world or model; empty if there is none.
        """
        self.element = element
        self.where = where
        self.pose = pose
        self._frame_name = _SCOPES[element.tag]
        self._elements: dict[str, Element] = {}
        for child in element:
            if child.tag not in _FRAMES:
                continue
            name = child.get("name", "")
            if name in self._elements:
                raise WorldError(
                    f"{self._describe(child)} has the name of another element; "
                    "give it its own name"
                )
            self._elements[name] = child
        self._states = {(child.tag, child.get("name")): child for child in state}
        # Poses by name; None while a pose is being computed.
        self._frames: dict[str, Transform | None] = {self._frame_name: pose}
        self._models: dict[Element, tuple[Scope, float]] = {}

    def models(self) -> Iterator[tuple["Scope", float]]:
        """Yield scopes of the models directly in this one, with a factor on radii."""
        return map(self._model, self.element.findall("model"))

    def locate(self, element: Element, base: Transform | None = None) -> Transform:
        """Return an element's pose in the world; a saved state wins over <pose>.

        Args:
            element: A link, frame, joint or model, or a collision of a link.
            base: Pose that its own is relative to unless it names a frame. By default
                the frame of this scope.
        """
        where = self._describe(element)
        saved_pose = self._state(element).find("pose")
        if saved_pose is not None:
            # Gazebo Classic saves poses relative to the world.
            return read_pose(saved_pose, where)

        pose = element.find("pose")
        # <child> is the link that a joint moves.
        reference = element.get("attached_to") or element.findtext("child")
        if pose is not None:
            # `frame` is what SDF 1.6 called it.
            reference = pose.get("relative_to") or pose.get("frame") or reference
        if reference:
            base = self.frame(reference.strip())
        return (base or self.pose) @ read_pose(pose, where)

    def frame(self, name: str) -> Transform:
        """Return a name's pose in the world, cached; WorldError if none or circular."""
        if name not in self._frames:
            self._frames[name] = None
            try:
                self._frames[name] = self._locate_name(name)
            except RecursionError:
                raise WorldError(f"{self.where}: frames nested too deeply") from None
        pose = self._frames[name]
        if pose is None:
            raise WorldError(f"{self.where}: frame {name!r:.60} is relative to itself")
        return pose

    def _locate_name(self, name: str) -> Transform:
        """Compute the world pose of an element by its name; WorldError if unknown."""
        element = self._elements.get(name)
        if element is not None:
            if element.tag == "model":
                return self._model(element)[0].pose
            return self.locate(element)
        model, _, inner_name = name.partition(_SEPARATOR)
        if inner_name and model in self._elements:
            scope, _ = self._model(self._elements[model])
            return scope.frame(inner_name)
        names = (self._frame_name, *self._elements)
        raise WorldError(f"{self.where}: no frame {name!r:.60}{suggest(name, names)}")

    def _model(self, element: Element) -> tuple["Scope", float]:
        """Return the scope of a model in this one and the factor on its radii."""
        if element in self._models:
            return self._models[element]
        where = self._describe(element)
        state = self._state(element)
        pose = self.locate(element)
        placement = element.get("placement_frame")
        if placement and state.find("pose") is None:
            # The pose is the frame's; the model's follows from it.
            at_origin = Scope(element, where, Transform(), Element("state"))
            pose = pose @ at_origin.frame(placement).inverse()

        scale = read_numbers(state.findtext("scale", "1 1 1"), 3, f"{where}: scale")
        self._models[element] = Scope(element, where, pose, state), max(scale[:2])
        return self._models[element]

    def _state(self, element: Element) -> Element:
        """Return the saved state of a model or link, empty if there is none."""
        return self._states.get((element.tag, element.get("name")), Element("state"))

    def _describe(self, element: Element) -> str:
        """Return path, model and an element in it as the beginning of a message."""
        return (
            f"{self.where}: {element.tag} {element.get('name', 'without a name')!r:.60}"
        )


def read_pose(pose: Element | None, where: str) -> Transform:
    """Return the transform of a <pose>, identity for None or empty; WorldError if bad.

    Args:
        pose: The element, with its attributes `rotation_format` and `degrees`.
        where: Path of the file and name of the model, to begin messages with.

    Raises:
        WorldError: If the format is unknown or the numbers do not fit it.
    """
    if pose is None or not (pose.text or "").strip():
        return Transform()
    rotation_format = pose.get("rotation_format", "euler_rpy")
    count = _NUMBERS.get(rotation_format)
    if count is None:
        raise WorldError(
            f"{where}: unknown rotation_format {rotation_format!r:.60}"
            f"{suggest(rotation_format, _NUMBERS)}"
        )
    in_degrees = pose.get("degrees", "false").lower() in ("true", "1")
    if in_degrees and count == 7:
        raise WorldError(f"{where}: pose must not have both degrees and quat_xyzw")

    numbers = read_numbers(pose.text, count, f"{where}: pose")
    rotation = numbers[3:]
    offset = np.array(numbers[:3])
    if count == 7:
        if not any(rotation):
            raise WorldError(f"{where}: pose must not have a quaternion of length 0")
        return Transform(offset, quaternion_matrix(*rotation))
    if not any(rotation):
        # Nearly all poses in worlds have no rotation, and this is faster.
        return Transform(offset)
    if in_degrees:
        rotation = np.deg2rad(rotation).tolist()
    return Transform(offset, rotation_matrix(*rotation))
