//! How hard and how fast a grasp may be.

use crate::params;

/// What an order may ask for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Profile {
    /// What most things bear.
    #[default]
    Normal,
    /// Eggs.
    Fragile,
    /// Tools.
    Strong,
}

impl Profile {
    /// Of the flags of an order; none where they mean nothing.
    pub const fn of(bits: u8) -> Option<Self> {
        match bits {
            0 => Some(Self::Normal),
            1 => Some(Self::Fragile),
            2 => Some(Self::Strong),
            _ => None,
        }
    }

    /// Greatest force in newtons, growth after a slip included.
    pub const fn most_n(self) -> f32 {
        match self {
            Self::Fragile => 20.0,
            Self::Normal => 100.0,
            Self::Strong => params::GRASP_FORCE.value as f32,
        }
    }

    /// Greatest speed of closing in mm/s.
    pub const fn most_mm_s(self) -> f32 {
        match self {
            Self::Fragile => 5.0,
            Self::Normal | Self::Strong => params::CLOSING_SPEED.value as f32,
        }
    }
}

/// No force is asked for beyond this, in newtons.
pub const CEILING_N: f32 = 400.0;
/// Beyond this force in newtons the fingers give way, whatever is asked.
pub const TRIP_N: f32 = 450.0;

const _: () = assert!(Profile::Strong.most_n() <= CEILING_N && CEILING_N < TRIP_N);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_profiles_and_no_fourth() {
        let caps = [0, 1, 2].map(|bits| Profile::of(bits).unwrap().most_n());
        assert_eq!(caps, [100.0, 20.0, 350.0]);
        assert_eq!(Profile::of(3), None);
    }
}
