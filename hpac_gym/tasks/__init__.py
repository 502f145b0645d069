"""The tasks: sampling, judging, observations and rewards, as functions of the `SceneState` of n
worlds.
"""
