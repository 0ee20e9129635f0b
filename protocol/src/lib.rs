//! Everything a link board and the host say to each other, and nothing else.
#![no_std]
