//! Programs for link boards: the key that signs them, what an image says about itself, and signed images as files.
//!
//! A signed image is `TKPG`, the manifest's bytes, the 64 bytes of the signature, and the image.

use std::fs::File;
use std::path::Path;

use ed25519_dalek::{Signature, Signer, SigningKey, VerifyingKey};
use sha2::{Digest, Sha256};
use thermokin_protocol::update::{Manifest, Target};
use thermokin_protocol::{Firmware, Key};

use super::registry::{hex, new_key, read_secret, write_secret};
use crate::input::InputError;

const MAGIC: [u8; 4] = *b"TKPG";
const HEAD: usize = 4 + Manifest::LENGTH + 64;

/// An image of an ESP32: its header's magic byte and where the chip's number is.
const IMAGE_MAGIC: u8 = 0xE9;
const CHIP: usize = 12;
/// Where the program's descriptor lies in its first segment, its magic word, and where in it the version is.
const DESCRIPTOR: usize = 32;
const DESCRIPTOR_MAGIC: u32 = 0xABCD_5432;
const VERSION: std::ops::Range<usize> = DESCRIPTOR + 16..DESCRIPTOR + 48;

/// A program and the signature that boards ask for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SignedProgram {
    /// What is signed.
    pub manifest: Manifest,
    /// The signature.
    pub signature: [u8; 64],
    /// The bytes of the program.
    pub image: Vec<u8>,
}

impl SignedProgram {
    /// Signs an image.
    ///
    /// # Errors
    ///
    /// An image of 4 GiB or more.
    pub fn sign(image: Vec<u8>, target: Target, version: Firmware, key: &SigningKey) -> Result<Self, String> {
        let length = u32::try_from(image.len()).map_err(|_| "is no board's program: longer than 4 GiB".to_owned())?;
        let manifest = Manifest { target, version, length, digest: Sha256::digest(&image).into() };
        let signature = key.sign(&manifest.signed_bytes()).to_bytes();
        Ok(Self { manifest, signature, image })
    }

    /// The file's bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        [&MAGIC[..], &self.manifest.to_bytes(), &self.signature, &self.image].concat()
    }

    /// Reads a file's bytes; what boards would find wrong is told here, but for the key, which only they know.
    ///
    /// # Errors
    ///
    /// What is wrong with them.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, String> {
        let Some((head, image)) = bytes.split_first_chunk::<HEAD>().filter(|(head, _)| head[..4] == MAGIC) else {
            return Err("is not a signed program of thermokin board update".to_owned());
        };
        let (mut manifest, mut signature) = ([0; Manifest::LENGTH], [0; 64]);
        manifest.copy_from_slice(&head[4..4 + Manifest::LENGTH]);
        signature.copy_from_slice(&head[4 + Manifest::LENGTH..]);
        let manifest = Manifest::from_bytes(&manifest).ok_or("is a program for a board that is not known here")?;
        if image.len() as u64 != u64::from(manifest.length) || Sha256::digest(image)[..] != manifest.digest {
            return Err("is damaged: its bytes are not those that were signed".to_owned());
        }
        Ok(Self { manifest, signature, image: image.to_vec() })
    }

    /// Whether a board with this public key would take the signature.
    pub fn is_signed_by(&self, public: &[u8; 32]) -> bool {
        let signature = Signature::from_bytes(&self.signature);
        VerifyingKey::from_bytes(public)
            .is_ok_and(|key| key.verify_strict(&self.manifest.signed_bytes(), &signature).is_ok())
    }
}

/// What an ESP32's image says of itself: the chip and the program's version. None of what is not such an image.
///
/// # Errors
///
/// An image for a chip that no board has, or without a descriptor that can be read.
pub fn described(image: &[u8]) -> Option<Result<(Target, Firmware), String>> {
    let half = |at: usize| image.get(at..at + 2).map(|bytes| u16::from_le_bytes([bytes[0], bytes[1]]));
    if image.first() != Some(&IMAGE_MAGIC) {
        return None;
    }
    let target = match half(CHIP) {
        Some(5) => Target::Esp32c3,
        Some(13) => Target::Esp32c6,
        other => return Some(Err(format!("is for a chip that no board has (number {})", other.unwrap_or(u16::MAX)))),
    };
    let magic = image.get(DESCRIPTOR..DESCRIPTOR + 4).map(|word| [word[0], word[1], word[2], word[3]]);
    if magic.map(u32::from_le_bytes) != Some(DESCRIPTOR_MAGIC) {
        return Some(Err("has no descriptor where ESP-IDF's bootloader looks for it".to_owned()));
    }
    let version = image.get(VERSION).and_then(|text| {
        let text = text.split(|&byte| byte == 0).next()?;
        version(std::str::from_utf8(text).ok()?)
    });
    Some(version.map(|version| (target, version)).ok_or_else(|| "says no version of the form 1.2.3".to_owned()))
}

/// Reads a version of the form 1.2.3.
pub fn version(text: &str) -> Option<Firmware> {
    let numbers: Vec<u16> = text.split('.').map(|part| part.parse().ok()).collect::<Option<_>>()?;
    let [major, minor, patch] = numbers[..] else { return None };
    Some(Firmware { major, minor, patch })
}

/// The key that signs programs: from its file, or made once and written there, readable by its owner only.
///
/// # Errors
///
/// A file that cannot be read or written, that others may read, or that holds no key.
pub fn signing_key(path: &Path) -> Result<SigningKey, InputError> {
    let failed = |error: std::io::Error| InputError::of_file(path, error.to_string());
    let file = match File::open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
                std::fs::create_dir_all(folder).map_err(failed)?;
            }
            let key = new_key().map_err(failed)?;
            write_secret(path, format!("{}\n", hex(&key)).as_bytes()).map_err(failed)?;
            return Ok(SigningKey::from_bytes(key.expose()));
        }
        Err(error) => return Err(failed(error)),
    };
    let text = read_secret(path, file, "a key")?;
    let key = Key::from_hex(text.trim()).map_err(|error| InputError::of_file(path, error.to_string()))?;
    Ok(SigningKey::from_bytes(key.expose()))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    fn signed() -> (SignedProgram, SigningKey) {
        let key = SigningKey::from_bytes(&[3; 32]);
        let version = Firmware { major: 1, minor: 2, patch: 3 };
        (SignedProgram::sign(vec![7; 1000], Target::Esp32c3, version, &key).expect("it is short"), key)
    }

    #[test]
    fn a_signed_program_is_read_back_and_no_byte_may_change() {
        let (program, key) = signed();
        let bytes = program.to_bytes();
        assert_eq!(SignedProgram::from_bytes(&bytes), Ok(program.clone()));
        assert!(program.is_signed_by(&key.verifying_key().to_bytes()));
        for at in 0..bytes.len() {
            let mut changed = bytes.clone();
            changed[at] ^= 0x20;
            let taken = SignedProgram::from_bytes(&changed);
            assert!(
                taken.is_err() || taken.is_ok_and(|taken| !taken.is_signed_by(&key.verifying_key().to_bytes())),
                "byte {at}"
            );
        }
        assert!(SignedProgram::from_bytes(&bytes[..bytes.len() - 1]).is_err());
    }

    #[test]
    fn the_key_is_made_once_and_only_its_owner_may_read_it() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("keys").join("update.key");
        let key = signing_key(&path).expect("it is made");
        assert_eq!(signing_key(&path).expect("it is read").to_bytes(), key.to_bytes());
        let mode = std::fs::metadata(&path).expect("it exists").permissions().mode() & 0o777;
        assert_eq!(mode, 0o600);
        std::fs::set_permissions(&path, PermissionsExt::from_mode(0o644)).expect("it is changed");
        let refused = signing_key(&path).expect_err("others may read it").to_string();
        assert!(refused.contains("has mode 644 but holds a key"), "{refused}");
        std::fs::set_permissions(&path, PermissionsExt::from_mode(0o600)).expect("it is changed");
        std::fs::write(&path, "short").expect("it is written");
        assert!(signing_key(&path).expect_err("it is no key").to_string().contains("64 hexadecimal digits"));
    }

    #[test]
    fn an_image_says_what_it_is() {
        let mut image = vec![0; 400];
        image[0] = 0xE9;
        image[12] = 5;
        image[32..36].copy_from_slice(&0xABCD_5432_u32.to_le_bytes());
        image[48..53].copy_from_slice(b"0.1.7");
        let version = Firmware { major: 0, minor: 1, patch: 7 };
        assert_eq!(described(&image), Some(Ok((Target::Esp32c3, version))));
        image[12] = 13;
        assert_eq!(described(&image), Some(Ok((Target::Esp32c6, version))));
        image[12] = 9;
        assert!(described(&image).is_some_and(|said| said.is_err()));
        assert_eq!(described(b"\x7FELF"), None);
        assert!(described(&[0xE9, 0, 0]).is_some_and(|said| said.is_err()), "cut off");
    }
}
