//! Finds where a simulator and measurements disagree, names the missing effect, adds it to the model and shows the gap
//! shrink.
