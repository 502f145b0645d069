"""Physics of hand, wrist and object: engine interface, servos and tendon law, with one folder per
engine.
"""
