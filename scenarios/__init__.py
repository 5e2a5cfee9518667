"""Named frozen values that join plants, sensors, filters, topology, rule, bus and seed."""
