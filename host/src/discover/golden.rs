//! The top of a function of one number by golden section.

/// Where a function with one top between bounds is largest, and its value there.
pub(super) fn golden(mut low: f64, mut high: f64, steps: usize, mut of: impl FnMut(f64) -> f64) -> (f64, f64) {
    const SECTION: f64 = 0.618_033_988_749_895;
    let (mut left, mut right) = (high - SECTION * (high - low), low + SECTION * (high - low));
    let (mut at_left, mut at_right) = (of(left), of(right));
    for _ in 0..steps {
        if at_left > at_right {
            (high, right, at_right) = (right, left, at_left);
            left = high - SECTION * (high - low);
            at_left = of(left);
        } else {
            (low, left, at_left) = (left, right, at_right);
            right = low + SECTION * (high - low);
            at_right = of(right);
        }
    }
    if at_left > at_right { (left, at_left) } else { (right, at_right) }
}
