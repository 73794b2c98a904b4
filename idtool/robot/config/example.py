"""A configuration with every key, from which error messages take their examples."""

EXAMPLE = """\
joints: [hip, knee]
locked_joints: {tail: 0.3}
gravity: [0, 0, -9.81]
log:
  topic: /joint_states
  columns: {t: stamp}
  scale: {q: {hip: 0.0175}, v: {hip: 0.0175}, tau: {hip: 1.27}, qcmd: {hip: 0.0175}, vcmd: {hip: 0.0175}}
  preset: unitree_go
  fields: {imu.gyro: imu_state.gyroscope}
  field_joints: [hip, knee]
velocity: auto
bounding_ellipsoids:
  thigh: [{center: [0, 0, -0.17], semi_axes: [0.08, 0.08, 0.25]}]
  shank: [{semi_axes: [0.05, 0.05, 0.2], rpy: [0, 0, 0]}]
bounding_shapes:
  thigh: [{kind: box, center: [0, 0, -0.17], size: [0.06, 0.06, 0.35]}]
  shank: [{kind: capsule, radius: 0.03, length: 0.3, rpy: [0, 0, 0]}]
  foot: [{kind: hull, file: foot.stl}]
known_com: {thigh: [0, 0, -0.17]}
rotors:
  hip_rotor: {joint: hip, gear_ratio: 9, inertia: 0.0001}
  knee_rotor:
    parent: thigh
    joint: knee
    gear_ratio: 9
    axis: [0, 1, 0]
    origin: {xyz: [0, 0.05, 0], rpy: [0, 0, 0]}
    inertial: {mass: 0.1, com: [0, 0, 0], inertia: [0.0001, 0, 0.0002, 0, 0, 0.0001]}
    bounding_ellipsoid: {semi_axes: [0.05, 0.05, 0.05], center: [0, 0, 0], rpy: [0, 0, 0]}
  belt_rotor: {coupling: {hip: 9, knee: 9}, inertia: 0.0001}
armature: {hip: 0.05}
friction: {viscous: true, coulomb: {value: 1.2, standard_error: 0.1}, offset: true}
constraints: ellipsoid
regularization: {kind: euclidean, weight: 1, mass_precision: 5, units: relative}
filter: {kind: butterworth, cutoff_hz: 40, order: 4}
known: {mass: {thigh: {value: 0.63, standard_error: 0.01}}, total_mass: 2.3}
mirror: [{body: FR_thigh, of: FL_thigh, plane: xz}, {joint: FR_hip, of: FL_hip}]
effects:
  - {effect: torque_offset, joint: hip, parameters: {offset: 0}}
  - {effect: payload, link: thigh, parameters: {mass: 0, com: [0, 0, 0], inertia: [0, 0, 0, 0, 0, 0]}}
solver: {name: cvxpy, backend: SCS}
controller: {kp: 25, kd: 1, delay: 0.005}
simulation: {window: 1}
limits: {position: [-1, 1], velocity: 5, acceleration: 50, effort: 20}
base:
  kind: floating
  link: trunk
  imu: {link: imu_link, topic: /imu, delay: 0}
  pose: {link: trunk, topic: /pose, delay: 0}
  noise: {hip: 0.1}
contacts:
  - {name: FL, link: FL_foot, flag: contact_FL}
  - {name: HL, link: HL_foot, point: [0, 0, 0], radius: 0.02, compliance: fit, flag: auto, widen: 0.12}
  - {name: FR, link: FR_foot, kind: surface, frame: world, force: [fx, fy, fz], moment: [mx, my, mz], sign: 1}
wrench_sensors:
  - {joint: ft, topic: /ft}
  - {joint: ft2, topic: /ft2, channel: ft2, frame: tool, sign: 1, offset: fit, common_offset: false, drift: auto}
pool: {shared: bodies, own: [friction], robots: {leg1: [leg1_*.mcap]}}
seed: 0
"""
