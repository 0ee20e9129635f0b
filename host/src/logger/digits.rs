//! Numbers as decimal digits, written where they belong: a hundred thousand records a second have a dozen each, and the
//! standard library's formatting takes several times as long.

use thermokin_protocol::SensorKind;

/// Appends a number.
pub(super) fn unsigned(out: &mut Vec<u8>, mut number: u64) {
    let mut digits = [0; 20];
    let mut at = digits.len();
    loop {
        at -= 1;
        digits[at] = b'0' + (number % 10) as u8;
        number /= 10;
        if number == 0 {
            break;
        }
    }
    out.extend_from_slice(&digits[at..]);
}

/// Appends a number with its sign.
pub(super) fn signed(out: &mut Vec<u8>, number: i64) {
    if number < 0 {
        out.push(b'-');
    }
    unsigned(out, number.unsigned_abs());
}

/// Appends so many digits of a number, zeros in front included.
fn padded<const DIGITS: usize>(out: &mut Vec<u8>, mut number: u64) {
    let mut digits = [b'0'; DIGITS];
    for digit in digits.iter_mut().rev() {
        *digit = b'0' + (number % 10) as u8;
        number /= 10;
    }
    out.extend_from_slice(&digits);
}

/// Appends microseconds as seconds with six decimals: exact, where a floating-point number would not be.
pub(super) fn seconds(out: &mut Vec<u8>, us: u64) {
    unsigned(out, us / 1_000_000);
    out.push(b'.');
    padded::<6>(out, us % 1_000_000);
}

/// Appends what [`SensorKind::celsius`] gives, exactly.
pub(super) fn celsius(out: &mut Vec<u8>, kind: SensorKind, counts: i16) {
    match kind {
        SensorKind::Max30205 | SensorKind::Lm75 => {
            let counts = i64::from(counts);
            if counts < 0 {
                out.push(b'-');
            }
            unsigned(out, counts.unsigned_abs() / 256);
            let parts = counts.unsigned_abs() % 256;
            if parts > 0 {
                out.push(b'.');
                // 1/256 is 0.00390625.
                padded::<8>(out, parts * 390_625);
                while out.last() == Some(&b'0') {
                    out.pop();
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(write: impl FnOnce(&mut Vec<u8>)) -> String {
        let mut out = Vec::new();
        write(&mut out);
        String::from_utf8(out).expect("digits")
    }

    #[test]
    fn every_temperature_reads_as_the_standard_librarys() {
        for kind in [SensorKind::Max30205, SensorKind::Lm75] {
            for counts in i16::MIN..=i16::MAX {
                assert_eq!(text(|out| celsius(out, kind, counts)), kind.celsius(counts).to_string());
            }
        }
    }

    #[test]
    fn numbers_of_every_length() {
        for shift in 0..64 {
            for number in [1_u64 << shift, (1 << shift) - 1, u64::MAX >> shift] {
                assert_eq!(text(|out| unsigned(out, number)), number.to_string());
                assert_eq!(text(|out| signed(out, number as i64)), (number as i64).to_string());
                let seconds = format!("{}.{:06}", number / 1_000_000, number % 1_000_000);
                assert_eq!(text(|out| super::seconds(out, number)), seconds);
            }
        }
    }
}
