"""The body of the hand and of what it grasps, as data, and the writers of its model files. No simulator, no physics."""
