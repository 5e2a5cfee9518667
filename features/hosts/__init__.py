"""Networks on several hosts: keys, certificates, remote starts."""
