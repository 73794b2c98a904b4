"""Self-collision: how near a robot's links come to each other.

The exact distance is found for those pairs first whose bounding spheres are nearest, until no other pair of spheres is
nearer than the least distance found.

Letters: q joint coordinates (nv, N) [rad or m]; R (3, 3) and p (3,) [m] a frame's place in another.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.exceptions import ModelError
from idtool.common.names import some
from idtool.robot.body import Frame
from idtool.robot.collision_geometry import ConvexPart, DistanceQueries, read_convex_parts
from idtool.robot.kinematics import body_placements
from idtool.robot.model import Model
from idtool.robot.urdf.reading import Joint, Robot

Pair = tuple[str, str]

_MOST_LINKS = 1000
_MOST_PAIRS = 500_000  # of pieces
_BLOCK = 1 << 20  # pairs times configurations held at a time
_TOUCH = 1e-4  # m
_SAMPLES = 200  # random configurations, to tell links that always touch
_SHARE = 0.5  # of these
_NO_LIMIT = {"prismatic": 0.5}  # m, of such a joint without limits; half a turn of others


@dataclass(frozen=True)
class SelfCollision:
    """Pairs of links that are not to collide.

    Not among them: links of one body, links joined by a joint, rotors, and links that touch at zero (or the nearest
    position within limits) or in more than half of random configurations, since these are made to.

    Attributes
    ----------
    model
        The tree of bodies.
    pairs
        The links checked against each other.
    warnings
        What a user should know of the geometry, a plain sentence each.
    """

    model: Model
    pairs: tuple[Pair, ...]
    warnings: tuple[str, ...]
    _parts: tuple[ConvexPart, ...]
    _part_pairs: Indices  # pieces that make pairs, shape (2, pairs of pieces)
    _link_pair: Indices  # the pair of links that each is of

    @classmethod
    def from_model(cls, model: Model, locked_joints: Mapping[str, float] | None = None) -> SelfCollision | None:
        """What can collide in a robot; None where there are no two such links with geometry that can be read.

        Parameters
        ----------
        model
            The tree of bodies.
        locked_joints
            Positions of the joints that are held still, 0 for those not named [rad or m].

        Raises
        ------
        ModelError
            If the geometry is of more pieces than can be checked.
        """
        pieces, unread = read_convex_parts(model.robot, _frames(model, locked_joints or {}))
        linked = {frozenset((joint.parent, joint.child)) for joint in model.robot.joints.values()}
        of_link: dict[str, list[int]] = {}
        for i, piece in enumerate(pieces):
            of_link.setdefault(piece.link, []).append(i)
        body = {piece.link: piece.frame.body for piece in pieces}
        if len(of_link) > _MOST_LINKS:
            raise ModelError(
                model.robot.path, f"has more than {_MOST_LINKS} links with geometry to check for collision"
            )
        pairs = [(a, b) for a, b in combinations(of_link, 2) if body[a] != body[b] and frozenset((a, b)) not in linked]
        if sum(len(of_link[a]) * len(of_link[b]) for a, b in pairs) > _MOST_PAIRS:
            raise ModelError(model.robot.path, "has too many pieces of geometry to check for collision; simplify it")
        ends = [(i, j, k) for k, (a, b) in enumerate(pairs) for i in of_link[a] for j in of_link[b]]
        if not ends:
            return None
        *both, owner = np.array(ends).T
        every = cls(model, tuple(pairs), unread, pieces, np.array(both), owner)
        touching = every._always_touching()
        return None if touching.all() else every._without(touching)

    def clearance(self, q: Array) -> Array:
        """The least distance of two links in each configuration, negative by the depth of a penetration.

        Parameters
        ----------
        q
            Positions of the joints, shape (nv, N).

        Returns
        -------
        Shape (N,) [m].
        """
        return self._min_distances(q)[0]

    def nearest(self, q: Array) -> tuple[Pair, float, int]:
        """The two links that come nearest to each other, their distance [m], and in which configuration.

        Parameters
        ----------
        q
            Positions of the joints, shape (nv, N), N at least 1.
        """
        least, owner = self._min_distances(q)
        at = int(least.argmin())
        return self.pairs[owner[at]], float(least[at]), at

    def _min_distances(self, q: Array) -> tuple[Array, Indices]:
        """The least distance in each configuration, and of which pair; shape (N,) each."""
        least, owner = np.full(q.shape[1], math.inf), np.zeros(q.shape[1], dtype=np.intp)
        for first, near, R, p in self._sphere_distances(q):
            order = np.argsort(near, axis=0).T.tolist()
            for n in range(near.shape[1]):
                best = math.inf
                for k in order[n]:
                    if near[k, n] >= best:
                        break
                    distance = self._distance(k, R[:, n], p[:, n])
                    if distance < best:
                        best, owner[first + n] = distance, self._link_pair[k]
                least[first + n] = best
        return least, owner

    def _sphere_distances(self, q: Array) -> Iterator[tuple[int, Array, Array, Array]]:
        """Block by block of configurations: the first's index, the distances of the pieces' spheres, places R, p."""
        radius = np.array([piece.radius + piece.swept_sphere_radius for piece in self._parts])
        i, j = self._part_pairs
        size = max(1, _BLOCK // len(i))
        for first in range(0, q.shape[1], size):
            R, p = self._placements(q[:, first : first + size])
            yield first, np.linalg.norm(p[i] - p[j], axis=2) - (radius[i] + radius[j])[:, None], R, p

    def _placements(self, q: Array) -> tuple[Array, Array]:
        """Where the pieces are in the root link, shapes (pieces, N, 3, 3) and (pieces, N, 3)."""
        places = body_placements(self.model, q)
        count, N = len(self._parts), q.shape[1]
        out_R, out_p = np.empty((count, N, 3, 3)), np.empty((count, N, 3))
        for k, piece in enumerate(self._parts):
            R, p = places[piece.frame.body]
            out_R[k], out_p[k] = R @ piece.frame.R, p + R @ piece.frame.p
        return out_R, out_p

    @cached_property
    def _distance(self) -> DistanceQueries:
        return DistanceQueries(self._parts, self._part_pairs)

    def _always_touching(self) -> Mask:
        """Which pairs of links touch by the way they are made, shape (pairs,)."""
        joints = self.model.joints
        free = [_NO_LIMIT.get(joint.kind, math.pi) for joint in joints]
        lower = np.array([j.lower if math.isfinite(j.lower) else -x for j, x in zip(joints, free, strict=True)])
        upper = np.array([j.upper if math.isfinite(j.upper) else x for j, x in zip(joints, free, strict=True)])
        share = np.random.default_rng(0).random((len(joints), _SAMPLES))
        random = lower[:, None] + (upper - lower)[:, None] * share
        at_zero = self._touching(np.clip(0, lower, upper)[:, None])[:, 0]
        return np.asarray(at_zero | (self._touching(random).mean(axis=1) > _SHARE))

    def _touching(self, q: Array) -> Mask:
        """Which pairs of links touch in which configuration, shape (pairs, N)."""
        touching = np.zeros((len(self.pairs), q.shape[1]), dtype=bool)
        for first, near, R, p in self._sphere_distances(q):
            for k, n in np.argwhere(near <= _TOUCH):
                if not touching[self._link_pair[k], first + n]:
                    touching[self._link_pair[k], first + n] = self._distance(k, R[:, n], p[:, n]) <= _TOUCH
        return touching

    def _without(self, excluded: Mask) -> SelfCollision:
        """Without some of the pairs of links, shape (pairs,)."""
        if not excluded.any():
            return self
        names = [f"{a} and {b}" for (a, b), out in zip(self.pairs, excluded, strict=True) if out]
        said = f"links that touch by construction, not checked for collision: {some(names)}"
        kept = ~excluded[self._link_pair]
        pairs = tuple(pair for pair, out in zip(self.pairs, excluded, strict=True) if not out)
        owner = (np.cumsum(~excluded) - 1)[self._link_pair[kept]]
        return replace(
            self, pairs=pairs, warnings=(*self.warnings, said), _part_pairs=self._part_pairs[:, kept], _link_pair=owner
        )


def unread_geometry(model: Model) -> tuple[str, ...]:
    """What geometry of a robot cannot be read, a plain sentence: why there may be nothing to check."""
    return read_convex_parts(model.robot, _frames(model, {}))[1]


def _frames(model: Model, locked_joints: Mapping[str, float]) -> dict[str, Frame]:
    """Where every link is, rotors excepted."""
    robot = model.robot
    moving = {body.name: i for i, body in enumerate(model.bodies) if body.kind == "link"}
    rotors = {body.name for body in model.bodies if body.kind == "rotor"}
    frames = {robot.root: Frame(-1, np.eye(3), np.zeros(3))}
    for joint in robot.joints.values():
        if joint.child in moving:
            frames[joint.child] = Frame(moving[joint.child], np.eye(3), np.zeros(3))
            continue
        mount, x = frames[joint.parent].compose(joint.R, joint.p), _held_at(joint, robot, locked_joints)
        if joint.kind == "prismatic":
            frames[joint.child] = mount.compose(np.eye(3), joint.axis * x)
        else:
            frames[joint.child] = mount.compose(Rotation.from_rotvec(joint.axis * x).as_matrix(), np.zeros(3))
    return {link: frame for link, frame in frames.items() if link not in rotors}


def _held_at(joint: Joint, robot: Robot, locked_joints: Mapping[str, float]) -> float:
    """Position of a joint that does not move [rad or m]."""
    if joint.kind == "fixed":
        return 0.0
    if joint.mimic is None:
        return locked_joints.get(joint.name, 0.0)
    return joint.mimic.multiplier * _held_at(robot.joints[joint.mimic.joint], robot, locked_joints) + joint.mimic.offset
