"""Geometry of the hand and of objects as data, and the writers of their model files. Imports no
simulator.
"""
