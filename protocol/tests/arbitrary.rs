//! Arbitrary bytes, and arbitrary messages under the right key, never make either end panic. The corpus of the fuzz
//! targets (`protocol/fuzz`) runs here as well, so that it counts in every test run.

use proptest::prelude::*;

mod ends;

use ends::{datagram, message};

fn corpus(target: &str, run: fn(&[u8])) {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(target);
    let mut count = 0;
    for entry in std::fs::read_dir(&folder).expect("the corpus is committed") {
        run(&std::fs::read(entry.expect("a file of the corpus").path()).expect("it is read"));
        count += 1;
    }
    assert!(count >= 5, "{} files in {}", count, folder.display());
}

#[test]
fn the_corpus_of_datagrams() {
    corpus("datagram", datagram);
}

#[test]
fn the_corpus_of_messages() {
    corpus("message", message);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, ..ProptestConfig::default() })]

    #[test]
    fn arbitrary_datagrams(bytes in proptest::collection::vec(any::<u8>(), 0..1300)) {
        datagram(&bytes);
    }

    #[test]
    fn arbitrary_messages(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        message(&bytes);
    }
}
