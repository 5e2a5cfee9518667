"""The adaptive dual-layer UKF for vehicles."""
