//! Host side of the station's devices: ports, bus threads, clocks, health, reconnection.
