"""Suite of cases on which fusion rules are compared under the same noise."""
