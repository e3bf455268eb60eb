"""Positions in the ship's arrays.

    state (6,)         u    v    r  │  n    e    ψ         VELOCITY │ POSE
    wave motion (6,)   n    e    ψ  │  ṅ    ė    ψ̇         first-order motion of the pose, its rate
    measurement        u    v    r  │  n    e    ψ         as the state; (3,) where only the pose is

    stage table        b_n  b_e  b_ψ │ air_n  air_e │ water_n  water_e │ wave_n  wave_e
                       └── PLAIN ──┘ └──────── LOADED: what moves with the ship ────────┘
    load coefficients  wind on u, v, r │ drift on u, v, r

Numbers and not an enum: numba compiles a kernel with the value of a global number. Its cache on
disk does not see them change: after a change here, remove the `__pycache__` folders of `ship`.
"""

AXES = 3  # Surge, sway, yaw along the ship; or north, east, heading over ground
YAW = 2  # The moment among forces, the heading in a pose

U, V, R, NORTH, EAST, HEADING = range(6)
STATE = 6
VELOCITY, POSE = slice(U, NORTH), slice(NORTH, STATE)

RATE_NORTH, RATE_EAST, RATE_HEADING = range(AXES, 2 * AXES)  # Rates of wave motion, behind its pose

FORCE_NORTH, FORCE_EAST, FORCE_YAW = range(AXES)
AIR_NORTH, AIR_EAST, WATER_NORTH, WATER_EAST, WAVE_NORTH, WAVE_EAST = range(AXES, 9)
PLAIN, LOADED = AXES, 9  # Columns of a stage table without and with what moves with the ship
AIR, WATER, WAVE = (slice(first, first + 2) for first in (AIR_NORTH, WATER_NORTH, WAVE_NORTH))

WIND_U, WIND_V, WIND_R, DRIFT_U, DRIFT_V, DRIFT_R = range(6)
COEFFICIENTS = 6  # Number of load coefficients of the hull; the wind's three come first
