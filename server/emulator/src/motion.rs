//! Motions that touch every channel: contact poses, primitives, joint paths.
