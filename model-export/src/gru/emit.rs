//! A network as Rust source. The same network gives the same bytes.

use std::fmt::Debug;

use super::network::OUTPUTS;
use super::pack::Packed;

/// Without networks the table is empty, whatever its sizes.
pub const NO_NETWORKS: &str = "\n/// No recurrent networks.\n\
    pub static NETWORKS: [crate::model::network::Network<1, 4, 1>; 0] = [];\n";

/// Networks of several sizes, which one static cannot hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "networks of different sizes cannot share the device's table: train them with the same inputs and units"
)]
pub struct SeveralSizes;

/// The source of a static that holds `networks`, to stand at the end of a file of tables. Its type names the
/// size: an image links the kernel of that size and no other, by calls that can be followed. Without
/// networks it is empty, and no kernel is linked.
pub fn source(networks: &[Box<dyn Packed>]) -> Result<String, SeveralSizes> {
    let Some(first) = networks.first() else {
        return Ok(NO_NETWORKS.to_owned());
    };
    let mut text =
        "\n#[rustfmt::skip]\nuse crate::{model::network::*, units::{Field, Force}};\n\n".to_owned();
    let [inputs, hidden, sensors] = first.size();
    if networks
        .iter()
        .any(|network| network.size() != first.size())
    {
        return Err(SeveralSizes);
    }
    text += &format!(
        "/// Recurrent networks: {} inputs, two layers of {} units, {} outputs.\n",
        2 * inputs,
        2 * hidden,
        OUTPUTS * sensors,
    );
    text += "#[rustfmt::skip]\n";
    text += &format!(
        "pub static NETWORKS: [Network<{inputs}, {hidden}, {sensors}>; {}] = [\n",
        networks.len()
    );
    for network in networks {
        text += &network.source();
        text += ",\n";
    }
    Ok(text + "];\n")
}

/// The debug form of the struct is Rust's own notation but for the enums' names.
pub(super) fn network(network: &impl Debug) -> String {
    format!("{network:?}")
        .replace("target: ", "target: Target::")
        .replace("source: ", "source: Source::")
        .replace("UnitPair {", "\nUnitPair {")
        .replace("Head {", "\nHead {")
}
