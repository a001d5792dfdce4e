"""Large, aperiodic motion: moves, constant velocities, start and stop, velocity without position.

The base model is chosen to fit the data (rigid inertia with its couplings, or a mass on a spring to
ground); causes come from the same catalogue as everywhere, each with its gain on rows kept out.
"""
