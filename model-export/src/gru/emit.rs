//! A network as Rust source. The same network gives the same bytes.

use std::fmt::Debug;

use super::pack::Packed;

/// The source of a static that holds `networks`, all of one size, to stand in a file of tables. Its
/// type names the size: an image links the kernel of that size and no other, by calls that can be
/// followed.
pub fn source(networks: &[Box<dyn Packed>]) -> Option<String> {
    let [inputs, hidden, sensors] = networks.first()?.size();
    if networks
        .iter()
        .any(|network| network.size() != [inputs, hidden, sensors])
    {
        return None;
    }
    let mut text = format!(
        "\n/// {} recurrent network{} of {} inputs, two layers of {} units, {} outputs.\n",
        networks.len(),
        if networks.len() == 1 { "" } else { "s" },
        2 * inputs,
        2 * hidden,
        4 * sensors,
    );
    text += "#[rustfmt::skip]\nuse crate::model::network::*;\n#[rustfmt::skip]\n";
    text += crate::inverse::emit::IN_SRAM;
    text += &format!(
        "pub static NETWORKS: [Network<{inputs}, {hidden}, {sensors}>; {}] = [\n",
        networks.len()
    );
    for network in networks {
        text += &network.source();
        text += ",\n";
    }
    Some(text + "];\n")
}

/// The debug form of the struct is Rust's own notation but for the enums' names.
pub(super) fn network(network: &impl Debug) -> String {
    format!("{network:?}")
        .replace("target: ", "target: Target::")
        .replace("source: ", "source: Source::")
        .replace("UnitPair {", "\nUnitPair {")
        .replace("Head {", "\nHead {")
}
