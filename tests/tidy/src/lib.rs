//! The rules of `ARCHITECTURE.md` as tests; there is nothing here but tests.
