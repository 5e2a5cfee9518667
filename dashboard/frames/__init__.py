"""What the dashboard draws: messages and recordings turned into frames."""
