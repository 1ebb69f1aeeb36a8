//! The firmware's image: an ELF file's segments, symbols and log strings.

use std::path::{Path, PathBuf};

use object::elf::{EM_ARM, FileHeader32, PT_LOAD};
use object::read::elf::{ElfFile32, FileHeader, ProgramHeader};
use object::{Endianness, Object, ObjectSymbol};

use crate::peripherals::flash;

/// Why a file is no image for this chip.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The file is unreadable.
    #[error("{}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// It is no ELF file, or for another processor.
    #[error("{}: not an ELF file for a 32-bit Arm processor: build one with `cargo image`", path.display())]
    NotArm {
        /// The file.
        path: PathBuf,
    },
    /// A segment lies outside of flash.
    #[error("{}: a segment at {address:#010x} of {length} bytes is outside of the flash memory of 512 KiB", path.display())]
    OutsideFlash {
        /// The file.
        path: PathBuf,
        /// Where it would be loaded.
        address: u32,
        /// Its length in bytes.
        length: usize,
    },
    /// Flash would hold no vector table.
    #[error(
        "{}: no vector table at 0x08000000: the linker's arguments were lost (is RUSTFLAGS set in the environment?)",
        path.display()
    )]
    NoVectors {
        /// The file.
        path: PathBuf,
    },
}

/// A function or a static.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Symbol {
    /// Its address, without the bit that marks Thumb code.
    pub address: u32,
    /// Its length in bytes; zero where the file does not say.
    pub length: u32,
    /// Its name, demangled, without the hash.
    pub name: String,
}

/// An image.
#[derive(Clone, Debug)]
pub struct Image {
    /// Contents of flash: offset and bytes of each segment.
    pub(crate) segments: Vec<(usize, Vec<u8>)>,
    symbols: Vec<Symbol>,
    /// The file's bytes: log strings are in sections that are not loaded.
    pub(crate) elf: Vec<u8>,
}

impl Image {
    /// Reads an ELF file.
    ///
    /// # Errors
    /// [`ImageError`].
    pub fn read(path: &Path) -> Result<Self, ImageError> {
        let elf = std::fs::read(path)
            .map_err(|source| ImageError::Read { path: path.to_owned(), source })?;
        Self::parse(elf, path)
    }

    /// Parses the content of an ELF file; `path` is for messages.
    ///
    /// # Errors
    /// [`ImageError`].
    pub fn parse(elf: Vec<u8>, path: &Path) -> Result<Self, ImageError> {
        let not_arm = || ImageError::NotArm { path: path.to_owned() };
        let file = ElfFile32::<Endianness>::parse(&*elf).map_err(|_| not_arm())?;
        let endian = file.endian();
        let header: &FileHeader32<Endianness> = file.elf_header();
        if header.e_machine(endian) != EM_ARM {
            return Err(not_arm());
        }
        let mut segments = Vec::new();
        for program in file.elf_program_headers() {
            if program.p_type(endian) != PT_LOAD || program.p_filesz(endian) == 0 {
                continue;
            }
            let address = program.p_paddr(endian);
            let bytes = program.data(endian, &*elf).map_err(|()| not_arm())?;
            let offset = address.wrapping_sub(flash::BASE) as usize;
            if offset.checked_add(bytes.len()).is_none_or(|end| end > flash::SIZE) {
                let length = bytes.len();
                return Err(ImageError::OutsideFlash { path: path.to_owned(), address, length });
            }
            segments.push((offset, bytes.to_vec()));
        }
        if !segments.iter().any(|(offset, bytes)| *offset == 0 && bytes.len() >= 8) {
            return Err(ImageError::NoVectors { path: path.to_owned() });
        }
        let defined = file.symbols().filter(|symbol| !symbol.is_undefined());
        let mut symbols: Vec<_> = defined
            .filter_map(|symbol| {
                let name =
                    symbol.name().ok().filter(|name| !name.is_empty() && !name.starts_with('$'))?;
                let name = format!("{:#}", rustc_demangle::demangle(name));
                Some(Symbol {
                    address: symbol.address() as u32 & !1,
                    length: symbol.size() as u32,
                    name,
                })
            })
            .collect();
        symbols.sort_by_key(|symbol| (symbol.address, symbol.length));
        Ok(Self { segments, symbols, elf })
    }

    /// The function or static with an address within it.
    pub fn symbol_at(&self, address: u32) -> Option<&Symbol> {
        let end = self.symbols.partition_point(|symbol| symbol.address <= address);
        let mut before = self.symbols[..end].iter().rev();
        before.find(|symbol| address - symbol.address < symbol.length)
    }

    /// Symbols whose name ends so, or the whole of whose name is this.
    pub fn symbols_named<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a Symbol> {
        self.symbols.iter().filter(move |symbol| symbol.name.ends_with(name))
    }

    /// A place in the program as people read it: function and offset.
    pub fn place(&self, address: u32) -> String {
        match self.symbol_at(address) {
            Some(symbol) => format!("{address:#010x} in {}", symbol.name),
            None => format!("{address:#010x}"),
        }
    }

    /// Bytes of flash that the image takes.
    pub fn length(&self) -> usize {
        self.segments.iter().map(|(_, bytes)| bytes.len()).sum()
    }
}
