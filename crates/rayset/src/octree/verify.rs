//! Checking a whole file: every checksum and record, and with `deep` every bound and total that a render relies on.
