"""A hand for those who have none: the real firmware, whose pulses drive a simulated body with an object and an arm."""
