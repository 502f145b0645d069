"""Physics of hand, wrist and object: the engine seam, the servos, the tendon law; one folder for each engine."""
