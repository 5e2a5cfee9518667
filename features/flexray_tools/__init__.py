"""Tools for FlexRay buses: recordings, cluster files, slot design, response times, clocks."""
