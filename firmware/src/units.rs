//! Fixed-point quantities. Their raw integers are what the device computes with; the conversions to
//! floating point are for people and for the host.

/// A magnetic field in sixteenths of the sensor's count: room for what compensation adds and takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Field(pub i32);

impl Field {
    /// Fractional bits.
    pub const BITS: u32 = 4;

    /// From the sensor's counts.
    pub const fn from_counts(counts: i16) -> Self {
        Self((counts as i32) << Self::BITS)
    }

    /// In counts, for people.
    pub fn counts(self) -> f64 {
        f64::from(self.0) / f64::from(1_u32 << Self::BITS)
    }
}

/// A force in 1/1024 N; the range is two million newtons either way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Force(pub i32);

impl Force {
    /// Fractional bits.
    pub const BITS: u32 = 10;
    /// Units in a newton.
    pub const PER_NEWTON: f64 = (1_u32 << Self::BITS) as f64;

    /// For people.
    pub fn newtons(self) -> f64 {
        f64::from(self.0) / Self::PER_NEWTON
    }
}
