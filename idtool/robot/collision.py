"""Self-collision: the distance between a robot's links.

The exact distance is computed first for the pairs whose bounding spheres are nearest, until no other pair of spheres
is nearer than the smallest distance so far.

Letters: q joint coordinates (nv, N) [rad or m]; R (3, 3) and p (3,) [m] a frame's pose in another.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from itertools import combinations, product

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ModelError
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.robot.body import Frame
from idtool.robot.collision_geometry import ConvexPart, DistanceQueries, read_convex_parts
from idtool.robot.kinematics import body_placements
from idtool.robot.model import RobotModel
from idtool.robot.rotation import rotation_about
from idtool.robot.urdf.reading import Robot, UrdfJoint

LinkPair = tuple[str, str]

_MAX_LINKS = 1000
_MAX_PAIRS = 500_000  # of convex parts
_BLOCK = 1 << 20  # pairs times configurations held at a time
_TOUCHING = 1e-4  # m
_SAMPLES = 200  # random configurations, to tell links that always touch
_TOUCHING_SHARE = 0.5  # of these
_RANGE_WITHOUT_LIMITS = {"prismatic": 0.5}  # m to either side, of such a joint without limits; half a turn of others


@dataclass(frozen=True)
class SelfCollision:
    """Pairs of links that must not collide.

    Not among them: links of one body, links joined by a joint, rotors, and links that touch at zero (or the nearest
    position within limits) or in more than half of random configurations, since these are made to.

    Attributes
    ----------
    model
        The tree of bodies.
    pairs
        The links checked against each other.
    notices
        What a user should know of the geometry.
    """

    model: RobotModel
    pairs: tuple[LinkPair, ...]
    notices: tuple[Notice, ...]
    _parts: tuple[ConvexPart, ...]
    _part_pairs: Indices  # indices of the parts checked against each other, shape (2, pairs of parts)
    _link_pair: Indices  # index into `pairs` of each pair of parts

    @classmethod
    def from_model(cls, model: RobotModel, locked_joints: Mapping[str, float] | None = None) -> SelfCollision | None:
        """Pairs of a robot's links; None where there are no two such links with geometry that can be read.

        Parameters
        ----------
        model
            The tree of bodies.
        locked_joints
            Positions of the joints that are held still, 0 for those not named [rad or m].

        Raises
        ------
        ModelError
            If the geometry has more parts than can be checked.
        """
        parts, unread = read_convex_parts(model.robot, _link_frames(model, locked_joints or {}))
        parts_of: dict[str, list[int]] = {}
        body_of: dict[str, int] = {}
        for i, part in enumerate(parts):
            parts_of.setdefault(part.link, []).append(i)
            body_of[part.link] = part.frame.body
        if len(parts_of) > _MAX_LINKS:
            raise ModelError(
                model.robot.path, f"has more than {_MAX_LINKS} links with geometry, too many to check for collision"
            )

        adjacent = {frozenset((joint.parent, joint.child)) for joint in model.robot.joints.values()}
        pairs: list[LinkPair] = []
        for a, b in combinations(parts_of, 2):
            if body_of[a] != body_of[b] and frozenset((a, b)) not in adjacent:
                pairs.append((a, b))
        if sum(len(parts_of[a]) * len(parts_of[b]) for a, b in pairs) > _MAX_PAIRS:
            raise ModelError(model.robot.path, "has too many geometry elements to check for collision; simplify it")
        if not pairs:
            return None

        part_pairs: list[tuple[int, int]] = []
        link_pair: list[int] = []
        for k, (a, b) in enumerate(pairs):
            of_this_pair = list(product(parts_of[a], parts_of[b]))
            part_pairs += of_this_pair
            link_pair += [k] * len(of_this_pair)
        collision = cls(model, tuple(pairs), unread, parts, np.array(part_pairs).T, np.array(link_pair))
        touching = collision._always_touching()
        return None if touching.all() else collision._without(touching)

    def clearance(self, q: Array) -> Array:
        """Smallest distance of two links in each configuration, negative by the depth of a penetration.

        Parameters
        ----------
        q
            Positions of the joints, shape (nv, N).

        Returns
        -------
        Shape (N,) [m].
        """
        return self._min_distances(q)[0]

    def nearest(self, q: Array) -> tuple[LinkPair, float, int]:
        """The two links that come nearest to each other, their distance [m], and the index of the configuration.

        Parameters
        ----------
        q
            Positions of the joints, shape (nv, N), N at least 1.
        """
        distances, nearest_pair = self._min_distances(q)
        n = int(distances.argmin())
        return self.pairs[nearest_pair[n]], float(distances[n]), n

    def _min_distances(self, q: Array) -> tuple[Array, Indices]:
        """The smallest distance in each configuration, and the index of its pair of links; shape (N,) each."""
        smallest = np.full(q.shape[1], math.inf)
        nearest_pair = np.zeros(q.shape[1], dtype=np.intp)
        for first, spheres, R, p in self._sphere_distances(q):
            order = np.argsort(spheres, axis=0).T.tolist()
            for n in range(spheres.shape[1]):
                best = math.inf
                for k in order[n]:
                    if spheres[k, n] >= best:
                        break
                    distance = self._distance(k, R[:, n], p[:, n])
                    if distance < best:
                        best = distance
                        nearest_pair[first + n] = self._link_pair[k]
                smallest[first + n] = best
        return smallest, nearest_pair

    def _sphere_distances(self, q: Array) -> Iterator[tuple[int, Array, Array, Array]]:
        """Blocks of configurations: the first's index, distances of the parts' spheres, poses R, p of the parts."""
        radius = np.array([part.radius + part.swept_sphere_radius for part in self._parts])
        i, j = self._part_pairs
        size = max(1, _BLOCK // len(i))
        for first in range(0, q.shape[1], size):
            R, p = self._part_poses(q[:, first : first + size])
            between_centers = np.linalg.norm(p[i] - p[j], axis=2)
            yield first, between_centers - (radius[i] + radius[j])[:, None], R, p

    def _part_poses(self, q: Array) -> tuple[Array, Array]:
        """Poses of the parts in the root link, shapes (parts, N, 3, 3) and (parts, N, 3)."""
        placements = body_placements(self.model, q)
        shape = (len(self._parts), q.shape[1])
        R = np.empty((*shape, 3, 3))
        p = np.empty((*shape, 3))
        for k, part in enumerate(self._parts):
            R_body, p_body = placements[part.frame.body]
            R[k] = R_body @ part.frame.R
            p[k] = p_body + R_body @ part.frame.p
        return R, p

    @cached_property
    def _distance(self) -> DistanceQueries:
        return DistanceQueries(self._parts, self._part_pairs)

    def _always_touching(self) -> Mask:
        """Mask of the pairs of links that touch in every configuration, shape (pairs,)."""
        lower: list[float] = []
        upper: list[float] = []
        for joint in self.model.joints:
            default = _RANGE_WITHOUT_LIMITS.get(joint.kind, math.pi)
            lower.append(joint.lower if math.isfinite(joint.lower) else -default)
            upper.append(joint.upper if math.isfinite(joint.upper) else default)
        q_min, q_max = np.array(lower)[:, None], np.array(upper)[:, None]
        share = np.random.default_rng(0).random((len(lower), _SAMPLES))
        random = q_min + (q_max - q_min) * share
        at_zero = self._touching(np.clip(0, q_min, q_max))[:, 0]
        mostly = self._touching(random).mean(axis=1) > _TOUCHING_SHARE
        return np.asarray(at_zero | mostly)

    def _touching(self, q: Array) -> Mask:
        """Mask of the pairs of links that touch, by configuration, shape (pairs, N)."""
        touching = np.zeros((len(self.pairs), q.shape[1]), dtype=bool)
        for first, spheres, R, p in self._sphere_distances(q):
            for k, n in np.argwhere(spheres <= _TOUCHING):
                pair = self._link_pair[k]
                if not touching[pair, first + n]:
                    touching[pair, first + n] = self._distance(k, R[:, n], p[:, n]) <= _TOUCHING
        return touching

    def _without(self, excluded: Mask) -> SelfCollision:
        """A copy without some of the pairs of links, given as a mask, shape (pairs,)."""
        if not excluded.any():
            return self
        names = [f"{a} and {b}" for (a, b), out in zip(self.pairs, excluded, strict=True) if out]
        message = f"links that touch in all poses are not checked for collision: {join_names(names)}"
        notice = Notice("links_touch", "note", None, message)
        pairs = tuple(pair for pair, out in zip(self.pairs, excluded, strict=True) if not out)
        new_index = np.cumsum(~excluded) - 1
        kept = ~excluded[self._link_pair]
        return replace(
            self,
            pairs=pairs,
            notices=(*self.notices, notice),
            _part_pairs=self._part_pairs[:, kept],
            _link_pair=new_index[self._link_pair[kept]],
        )


def _link_frames(model: RobotModel, locked_joints: Mapping[str, float]) -> dict[str, Frame]:
    """Frame of every link except rotors."""
    robot = model.robot
    moving = {body.name: i for i, body in enumerate(model.bodies) if body.kind == "link"}
    rotors = {body.name for body in model.bodies if body.kind == "rotor"}
    frames = {robot.root: Frame(-1, np.eye(3), np.zeros(3))}
    for joint in robot.joints.values():
        if joint.child in moving:
            frames[joint.child] = Frame(moving[joint.child], np.eye(3), np.zeros(3))
            continue
        mount = frames[joint.parent].compose(joint.R, joint.p)
        position = _locked_position(joint, robot, locked_joints)
        if joint.kind == "prismatic":
            frames[joint.child] = mount.compose(np.eye(3), joint.axis * position)
        else:
            rotation = rotation_about(joint.axis, position)
            frames[joint.child] = mount.compose(rotation, np.zeros(3))
    return {link: frame for link, frame in frames.items() if link not in rotors}


def _locked_position(joint: UrdfJoint, robot: Robot, locked_joints: Mapping[str, float]) -> float:
    """Position of a joint that does not move [rad or m]."""
    if joint.kind == "fixed":
        return 0.0
    if joint.mimic is None:
        return locked_joints.get(joint.name, 0.0)
    leader = _locked_position(robot.joints[joint.mimic.joint], robot, locked_joints)
    return joint.mimic.multiplier * leader + joint.mimic.offset
