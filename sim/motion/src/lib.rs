//! Plans motions that touch every channel: contact postures, primitives, joint paths.
