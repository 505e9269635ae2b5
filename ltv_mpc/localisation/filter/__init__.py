"""Error-state Kalman filter of the vehicle and the water: state, propagation and measurement update."""
