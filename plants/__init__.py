"""The truth: dynamics, sensors, controllers and recorded data; imports nothing of ours."""
