"""One grasp in physics: come in, close, lift, perhaps shake; what touches the hand on its way in fails it.

Knows a table top in pybullet and a hand's pose; knows nothing of how the grasp was found.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sim_scenes.tabletop import Tabletop
from tools.grasping.hand import Grasp, HandConfig, hand_boxes

LEFT, RIGHT = 0, 1
"""The fingers' joints."""
TOUCH_M = 2e-4
"""Bodies this near touch: the gap that the simulation keeps [m]."""
CLOSE_S, HOLD_S = 0.5, 0.25
"""Time to close the fingers, and to settle at the end [s]."""
BASE_FORCE = 2000.0
"""Of the constraint that moves the hand [N]."""
PALM_KG, FINGER_KG = 1.0, 0.1


@dataclass(frozen=True)
class Protocol:
    """What a grasp has to stand."""

    lift: float = 0.10
    """Height it is lifted [m]."""
    held: float = 0.7
    """Share of the lift that an object between the fingers must have risen."""
    shake_m: float = 0.0
    """Amplitude of a shake in both horizontal directions [m]; 0: none."""
    shake_hz: float = 2.0
    """Its frequency."""
    shake_s: float = 2.0
    """Its duration."""


STRICT = Protocol(lift=0.20, shake_m=0.03)


@dataclass(frozen=True)
class Outcome:
    """held: index of the object in the hand in the order of placed(), None if there is none. reason: "held",
    "contact" on the way in (touched: with what), "missed" (nothing between the fingers), "slipped"."""

    held: int | None
    reason: str
    touched: str = ""

    @property
    def success(self) -> bool:
        return self.held is not None


def attempt(table: Tabletop, grasp: Grasp, hand: HandConfig, protocol: Protocol) -> Outcome:
    """Try a grasp on what stands on the table; the hand is gone afterwards, nothing else is taken away."""
    goal = grasp.T_world_hand
    back = goal.copy()
    back[:3, 3] -= hand.retreat * goal[:3, 2]
    with _Hand.at(table, back, hand) as body:
        for T in _way(back, goal[:3, 3], hand.speed * table.config.step_s):
            body.step(T)
            if touched := body.touches():
                return Outcome(None, "contact", touched)
        body.close(goal)
        between = body.between()
        if not between:
            return Outcome(None, "missed")
        heights = [_height(table, item) for item in between]
        lifted = goal.copy()
        lifted[2, 3] += protocol.lift
        for T in _way(goal, lifted[:3, 3], hand.speed * table.config.step_s):
            body.step(T)
        for T in _shake(lifted, protocol, table.config.step_s):
            body.step(T)
        for _ in range(round(HOLD_S / table.config.step_s)):
            body.step(lifted)
        for item, before in zip(between, heights):
            if item in body.between() and _height(table, item) - before > protocol.held * protocol.lift:
                return Outcome(table.bodies.index(item), "held")
    return Outcome(None, "slipped")


def _way(start: np.ndarray, end: np.ndarray, step: float) -> Iterator[np.ndarray]:
    """Poses from `start` (4, 4) straight to the position `end` (3,), `step` [m] at a time."""
    length = float(np.linalg.norm(end - start[:3, 3]))
    for share in np.linspace(0, 1, max(2, int(np.ceil(length / step)) + 1)):
        T = start.copy()
        T[:3, 3] = (1 - share) * start[:3, 3] + share * end
        yield T


def _shake(middle: np.ndarray, protocol: Protocol, step_s: float) -> Iterator[np.ndarray]:
    if not protocol.shake_m:
        return
    for i in range(round(protocol.shake_s / step_s)):
        time = i * step_s
        T = middle.copy()
        T[int(time > protocol.shake_s / 2), 3] += protocol.shake_m * np.sin(
            2 * np.pi * protocol.shake_hz * time
        )
        yield T


def _height(table: Tabletop, body: int) -> float:
    bullet, client = table.physics
    return float(bullet.getBasePositionAndOrientation(body, physicsClientId=client)[0][2])


class _Hand:
    """The hand as a body of pybullet: a palm that a constraint moves, and two sliding fingers."""

    def __init__(self, table: Tabletop, T: np.ndarray, config: HandConfig) -> None:
        self.table, self.config = table, config
        self.bullet, self.client = table.physics
        bullet, client = self.bullet, self.client
        self.body = self._build(T)
        position, turn = _pose(T)
        self.constraint = bullet.createConstraint(
            self.body, -1, -1, -1, bullet.JOINT_FIXED, [0, 0, 0], parentFramePosition=[0, 0, 0],
            childFramePosition=position, childFrameOrientation=turn, physicsClientId=client,
        )  # fmt: skip
        # Both fingers move as one, so that a held object stays in the middle.
        gear = bullet.createConstraint(
            self.body, LEFT, self.body, RIGHT, bullet.JOINT_GEAR, [0, 1, 0], [0, 0, 0], [0, 0, 0],
            physicsClientId=client,
        )  # fmt: skip
        bullet.changeConstraint(gear, gearRatio=-1, erp=0.2, maxForce=200, physicsClientId=client)
        self.gear = gear
        self._fingers(config.opening / 2)

    @classmethod
    @contextmanager
    def at(cls, table: Tabletop, T: np.ndarray, config: HandConfig) -> Iterator[_Hand]:
        """An open hand with its tips at T (4, 4), taken away at the end."""
        hand = cls(table, T, config)
        try:
            yield hand
        finally:
            for constraint in (hand.gear, hand.constraint):
                hand.bullet.removeConstraint(constraint, physicsClientId=hand.client)
            hand.bullet.removeBody(hand.body, physicsClientId=hand.client)

    def step(self, T: np.ndarray) -> None:
        """Move towards T and let one step of time pass."""
        position, turn = _pose(T)
        self.bullet.changeConstraint(
            self.constraint, position, turn, maxForce=BASE_FORCE, physicsClientId=self.client
        )
        self.bullet.stepSimulation(physicsClientId=self.client)

    def touches(self) -> str:
        """What touches the hand: "table", "object", or "" for nothing."""
        found = self._contacts()
        if not found:
            return ""
        return "object" if any(other in self.table.bodies for other, _ in found) else "table"

    def close(self, T: np.ndarray) -> None:
        """Close the fingers while the palm stays at T."""
        self._fingers(0.0)
        for _ in range(round(CLOSE_S / self.table.config.step_s)):
            self.step(T)

    def between(self) -> list[int]:
        """Bodies that both fingers touch."""
        found = self._contacts()
        left, right = ({body for body, link in found if link == side} for side in (LEFT, RIGHT))
        return [body for body in self.table.bodies if body in left and body in right]

    def _contacts(self) -> list[tuple[int, int]]:
        """(other body, own link) of all that touches."""
        points = self.bullet.getContactPoints(bodyA=self.body, physicsClientId=self.client)
        return [(point[2], point[3]) for point in points if point[8] < TOUCH_M and point[2] != self.body]

    def _fingers(self, place: float) -> None:
        """Drive both fingers to `place` [m] from the middle."""
        bullet = self.bullet
        for joint in (LEFT, RIGHT):
            bullet.setJointMotorControl2(
                self.body, joint, bullet.POSITION_CONTROL, targetPosition=place, force=self.config.force,
                maxVelocity=self.config.speed, physicsClientId=self.client,
            )  # fmt: skip

    def _build(self, T: np.ndarray) -> int:
        bullet, client, config = self.bullet, self.client, self.config
        boxes = hand_boxes(config, 0.0)
        halves, middles = (boxes[:, 1] - boxes[:, 0]) / 2, boxes.mean(1)
        left, right, palm = (
            bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=half.tolist(), physicsClientId=client)
            for half in halves
        )
        # The base's origin is the point between the tips; the palm stands behind it.
        palm = bullet.createCollisionShape(
            bullet.GEOM_BOX, halfExtents=halves[2].tolist(), collisionFramePosition=middles[2].tolist(),
            physicsClientId=client,
        )  # fmt: skip
        position, turn = _pose(T)
        body = bullet.createMultiBody(
            PALM_KG, palm, -1, position, turn,
            linkMasses=[FINGER_KG] * 2,
            linkCollisionShapeIndices=[left, right],
            linkVisualShapeIndices=[-1, -1],
            linkPositions=middles[:2].tolist(),
            linkOrientations=[[0, 0, 0, 1]] * 2,
            linkInertialFramePositions=[[0, 0, 0]] * 2,
            linkInertialFrameOrientations=[[0, 0, 0, 1]] * 2,
            linkParentIndices=[0, 0],
            linkJointTypes=[bullet.JOINT_PRISMATIC] * 2,
            linkJointAxis=[[0, -1, 0], [0, 1, 0]],
            physicsClientId=client,
        )  # fmt: skip
        for joint in (LEFT, RIGHT):
            bullet.resetJointState(body, joint, config.opening / 2, physicsClientId=client)
            bullet.changeDynamics(
                body, joint, lateralFriction=config.friction, spinningFriction=0.01, jointLowerLimit=0.0,
                jointUpperLimit=config.opening / 2, physicsClientId=client,
            )  # fmt: skip
            bullet.setCollisionFilterPair(body, body, -1, joint, 0, physicsClientId=client)
        bullet.setCollisionFilterPair(body, body, LEFT, RIGHT, 0, physicsClientId=client)
        return int(body)


def _pose(T: np.ndarray) -> tuple[list[float], list[float]]:
    """Position and quaternion x y z w."""
    return T[:3, 3].tolist(), Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
