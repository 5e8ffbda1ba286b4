//! The search for theta: the paper's grid, and the exact search that needs one sort per alpha.
