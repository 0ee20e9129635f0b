//! The configuration page: what is written is read back, and nothing else is.

use heapless::Vec;
use proptest::prelude::*;
use thermokin_protocol::{BadPage, Configuration, Key, MAX_PAGE, MAX_SENSORS, Sensor, SensorKind, Wifi};

fn configuration() -> impl Strategy<Value = Configuration> {
    let sensor = (any::<u8>(), prop_oneof![Just(SensorKind::Max30205), Just(SensorKind::Lm75)])
        .prop_map(|(address, kind)| Sensor { address, kind });
    let wifi = ("[ -~]{1,32}", "[ -~]{0,64}")
        .prop_map(|(ssid, password)| Wifi { ssid: fixed(&ssid), password: fixed(&password) });
    (
        (any::<u32>(), any::<[u8; 32]>(), any::<u32>(), any::<u16>()),
        ("[a-z0-9.]{1,63}", "[ -~]{0,63}"),
        proptest::collection::vec(sensor, 0..=MAX_SENSORS),
        (proptest::option::of(wifi), proptest::option::of(any::<[u8; 32]>())),
    )
        .prop_map(|((board, key, first_boot, port), (host, place), sensors, (wifi, update_key))| Configuration {
            board,
            key: Key::from_bytes(key),
            first_boot,
            host: fixed(&host),
            port,
            sensors: sensors.into_iter().collect(),
            place: fixed(&place),
            wifi,
            update_key,
        })
}

fn fixed<const CAPACITY: usize>(text: &str) -> heapless::String<CAPACITY> {
    heapless::String::try_from(text).expect("the strategy keeps to the capacity")
}

proptest! {
    #[test]
    fn a_page_is_read_back_with_erased_flash_behind_it(configuration in configuration()) {
        let mut page = configuration.to_page();
        page.resize(MAX_PAGE, 0xFF).unwrap();
        prop_assert_eq!(Configuration::from_page(&page), Ok(configuration));
    }

    #[test]
    fn any_changed_bit_is_noticed(configuration in configuration(), place in any::<prop::sample::Index>(), bit in 0..8u8) {
        let page = configuration.to_page();
        let mut changed = page.clone();
        let index = place.index(page.len());
        changed[index] ^= 1 << bit;
        // The reserved byte is the only one that means nothing.
        prop_assume!(index != 5);
        prop_assert!(Configuration::from_page(&changed).is_err());
    }

    #[test]
    fn a_page_that_is_cut_off_is_refused(configuration in configuration(), place in any::<prop::sample::Index>()) {
        let page = configuration.to_page();
        prop_assert!(Configuration::from_page(&page[..place.index(page.len())]).is_err());
    }

    #[test]
    fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..MAX_PAGE)) {
        let _ = Configuration::from_page(&bytes);
    }
}

#[test]
fn the_bytes_of_a_page_stay() {
    let configuration = Configuration {
        board: 3,
        key: Key::from_bytes([0xAA; 32]),
        first_boot: 7,
        host: fixed("10.0.2.2"),
        port: 5683,
        sensors: Vec::from_slice(&[Sensor { address: 0x48, kind: SensorKind::Max30205 }]).unwrap(),
        place: fixed("link 3"),
        wifi: Some(Wifi { ssid: fixed("cell"), password: fixed("secret") }),
        update_key: None,
    };
    let mut expected = b"TKCP\x01\x00\x56\x00".to_vec();
    expected.extend(0xC7B6_9EE4_u32.to_le_bytes());
    expected.extend(b"\x01\x04\x03\x00\x00\x00\x02\x20");
    expected.extend([0xAA; 32]);
    expected.extend(b"\x03\x04\x07\x00\x00\x00\x04\x0810.0.2.2\x05\x02\x33\x16\x06\x02\x48\x00\x07\x06link 3");
    expected.extend(b"\x08\x04cell\x09\x06secret");
    assert_eq!(&configuration.to_page()[..], &expected[..]);
    assert!(!format!("{configuration:?}").contains("secret"));
    assert_eq!(Configuration::from_page(&[0xFF; 64]), Err(BadPage::Absent));
}

#[test]
fn fields_that_are_not_known_yet_are_skipped() {
    let configuration = Configuration {
        board: 1,
        key: Key::from_bytes([1; 32]),
        first_boot: 1,
        host: fixed("host.local"),
        port: 1,
        sensors: Vec::new(),
        place: fixed(""),
        wifi: None,
        update_key: None,
    };
    let mut page = configuration.to_page().to_vec();
    page.extend([200, 3, 1, 2, 3]);
    let length = (page.len() - 12) as u16;
    page[6..8].copy_from_slice(&length.to_le_bytes());
    let crc = crc32fast::hash(&page[12..]);
    page[8..12].copy_from_slice(&crc.to_le_bytes());
    assert_eq!(Configuration::from_page(&page), Ok(configuration));
}
