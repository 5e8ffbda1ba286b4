//! Event metrics: L1, contact onset and offset error, activation F1, false positive rate.
