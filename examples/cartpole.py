"""Balances a pole on a cart by a linear-quadratic regulator: its parameters hold the masses and lengths that count.

slidectl daemon start --import examples/cartpole.py
slidectl spawn cartpole --controllers config/cartpole_control.yaml --start joint_state_controller lqr
"""

import numpy as np

from slidectl.control import (
    NUMBER,
    NUMBERS,
    EffortJointInterface,
    JointStateInterface,
    MultiInterfaceController,
    Parameter,
    Refused,
    params,
)

G = 9.8
CART = Parameter("cart_mass", NUMBER, "mass of the cart", "kg", 1.0)
POLE = Parameter("pole_mass", NUMBER, "mass of the pole", "kg", 0.2)
LENGTH = Parameter("pole_length", NUMBER, "length of the pole, a thin rod", "m", 1.0)
RAIL = Parameter("cart_damping", NUMBER, "effort against the cart's velocity", "N s/m", 0.5)
HINGE = Parameter("pole_damping", NUMBER, "effort against the pole's velocity", "N m s/rad", 0.01)
WEIGHTS = Parameter("weights", NUMBERS, "costs of cart position, pole angle and their velocities, squared")
EFFORT_WEIGHT = Parameter("effort_weight", NUMBER, "cost of the effort, squared", default=0.1)


def linearised(cart, pole, length, rail, hinge):
    """A and B of d(state)/dt = A state + B effort near upright; the state is x, angle and their velocities.

    (cart + pole) x'' + pole h angle'' = effort - rail x'
    pole h x'' + (I + pole h^2) angle'' = pole G h angle - hinge angle', with h = length / 2, I = pole length^2 / 12.
    """
    half = length / 2
    mass = np.array([[cart + pole, pole * half], [pole * half, pole * length**2 / 12 + pole * half**2]])
    stiffness, damping = np.diag([0.0, pole * G * half]), -np.diag([rail, hinge])
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [np.linalg.solve(mass, np.hstack([stiffness, damping]))]])
    return a, np.concatenate([np.zeros(2), np.linalg.solve(mass, [1.0, 0.0])])


def lqr(a, b, q, r):
    """K of effort = -K state that costs least: of the Hamiltonian matrix the stable half solves Riccati's equation."""
    values, vectors = np.linalg.eig(np.block([[a, -np.outer(b, b) / r], [-q, -a.T]]))
    stable = vectors[:, values.real < 0]
    p = np.real(stable[len(a) :] @ np.linalg.inv(stable[: len(a)]))
    return b @ p / r


class Lqr(MultiInterfaceController):
    """effort = -K (x, angle, x', angle') on cart_joint; it only reads pole_joint."""

    interface_types = (EffortJointInterface, JointStateInterface)
    parameters = (CART, POLE, LENGTH, RAIL, HINGE, WEIGHTS, EFFORT_WEIGHT)

    def init(self, hw, node):
        self.cart = hw.get(EffortJointInterface).get_handle("cart_joint")
        self.pole = hw.get(JointStateInterface).get_handle("pole_joint")
        *plant, weights, effort_weight = (params.value_of(node, parameter) for parameter in self.parameters)
        if weights is None or len(weights) != 4 or effort_weight <= 0:
            raise Refused("weights are four numbers, and effort_weight is above 0")
        a, b = linearised(*plant)
        self.gains = lqr(a, b, np.diag(weights), effort_weight).tolist()
        node.log("info", f"gains: {self.gains}")

    def update(self, time_ns, period_s):
        cart, pole = self.cart, self.pole
        state = (cart.position, pole.position, cart.velocity, pole.velocity)
        cart.command = -sum(gain * value for gain, value in zip(self.gains, state, strict=True))
