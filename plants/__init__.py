"""Plants: dynamics, sensors, controllers and recorded data; needs no package of ours."""
