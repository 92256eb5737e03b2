"""The JSBSim plant: the same vehicle file as an aircraft of JSBSim, whose own functions are the physics."""
