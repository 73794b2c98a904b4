"""Logs of robots in which an effect is hidden that no model of theirs has; shares no code with idtool.

MuJoCo moves the bodies, and effects act on the motion as forces, or on the sensors.
"""
