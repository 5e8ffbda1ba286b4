//! The accessible mirror: egui's AccessKit tree as elements of the page, for screen readers and browser tests alike.
