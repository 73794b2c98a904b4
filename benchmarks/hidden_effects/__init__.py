"""Logs of simulated robots with hidden effects that their models lack; shares no code with idtool.

MuJoCo moves the bodies. Effects act on the motion as forces, or on the sensors.
"""
