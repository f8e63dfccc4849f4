//! Colours to grey.

/// The grey of a colour, weighted as in Rec. 601 with weights out of 256.
pub fn luma([red, green, blue]: [u16; 3]) -> u16 {
    let [red, green, blue] = [red, green, blue].map(u32::from);
    ((77 * red + 150 * green + 29 * blue + 128) >> 8) as u16
}

/// [`luma`] of the first three bytes of a pixel.
pub fn luma_of_bytes(pixel: &[u8]) -> u8 {
    luma([pixel[0], pixel[1], pixel[2]].map(u16::from)) as u8
}
