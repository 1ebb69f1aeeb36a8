// Written by `magpie export`. Do not edit: fit again and export again.
//
// inputs    4204385f31deb651682314a9738fd35ec6b8fbcc57405a5631cd2a4d6b290bf1 (SHA-256 of the model file)
// model     fitted parameters, campaign demo
// effects   none
// recorded  not stated in recording.toml
// shape     6 x 6 centres, gamma 1.5944, ridge 1e-7
//
// Over the design box, in newtons, root mean square / greatest, for Fx and Fz:
// sensor 0: inverse 0.088 / 0.314, 0.090 / 0.413; fixed point against floating point 0.013 / 0.036, 0.014 / 0.052
// sensor 1: inverse 0.087 / 0.328, 0.085 / 0.430; fixed point against floating point 0.011 / 0.046, 0.013 / 0.059
// sensor 2: inverse 0.131 / 0.581, 0.127 / 0.783; fixed point against floating point 0.016 / 0.053, 0.022 / 0.102
// sensor 3: inverse 0.084 / 0.294, 0.088 / 0.439; fixed point against floating point 0.018 / 0.045, 0.015 / 0.058

use crate::model::formats::*;

/// The ideal model of every sensor.
pub static TABLES: Tables<'static> = Tables {
    id: 0x4204,
    exp: &EXP,
    sensors: &SENSORS,
    compensations: &[],
    check: 0x33fe0c32,
};

static EXP: [u32; EXP_ENTRIES] = [
    0x7ffefcd5, 0x7cd9fcdf, 0x7cd9fce9, 0x79c6fcf2, 0x79c7fcfc, 0x76c7fd06, 0x76c7fd0f, 0x73dbfd18,
    0x73dbfd22, 0x7101fd2b, 0x7101fd34, 0x6e3afd3d, 0x6e3afd45, 0x6b83fd4e, 0x6b83fd57, 0x68defd5f,
    0x68defd67, 0x6649fd70, 0x6649fd78, 0x63c5fd80, 0x63c5fd88, 0x6151fd8f, 0x6151fd97, 0x5eecfd9f,
    0x5eecfda6, 0x5c96fdae, 0x5c96fdb5, 0x5a4ffdbc, 0x5a4ffdc4, 0x5816fdcb, 0x5816fdd2, 0x55ebfdd9,
    0x55ebfddf, 0x53cefde6, 0x53cefded, 0x51befdf3, 0x51befdfa, 0x4fbbfe00, 0x4fbbfe07, 0x4dc5fe0d,
    0x4dc5fe13, 0x4bdbfe19, 0x4bdbfe1f, 0x49fdfe25, 0x49fdfe2b, 0x482bfe31, 0x482bfe37, 0x4664fe3c,
    0x4664fe42, 0x44a9fe47, 0x44a9fe4d, 0x42f8fe52, 0x42f8fe58, 0x4152fe5d, 0x4152fe62, 0x3fb7fe67,
    0x3fb7fe6c, 0x3e26fe71, 0x3e26fe76, 0x3c9efe7b, 0x3c9efe80, 0x3b20fe85, 0x3b20fe89, 0x39acfe8e,
    0x39acfe92, 0x3841fe97, 0x3841fe9b, 0x36defea0, 0x36defea4, 0x3585fea9, 0x3585fead, 0x3433feb1,
    0x3433feb5, 0x32ebfeb9, 0x32ebfebd, 0x31aafec1, 0x31aafec5, 0x3071fec9, 0x3071fecd, 0x2f40fed1,
    0x2f40fed5, 0x2e16fed8, 0x2e16fedc, 0x2cf4fedf, 0x2cf4fee3, 0x2bd9fee7, 0x2bd9feea, 0x2ac5feee,
    0x2ac5fef1, 0x29b7fef4, 0x29b7fef8, 0x28b0fefb, 0x28b0fefe, 0x27b0ff01, 0x27b0ff04, 0x26b6ff08,
    0x26b6ff0b, 0x25c2ff0e, 0x25c2ff11, 0x24d4ff14, 0x24d4ff17, 0x23ecff19, 0x23ecff1c, 0x230aff1f,
    0x230aff22, 0x222dff25, 0x222dff27, 0x2156ff2a, 0x2156ff2d, 0x2084ff2f, 0x2084ff32, 0x1fb7ff34,
    0x1fb7ff37, 0x1eefff39, 0x1eefff3c, 0x1e2dff3e, 0x1e2dff41, 0x1d6eff43, 0x1d6eff45, 0x1cb5ff48,
    0x1cb5ff4a, 0x1c00ff4c, 0x1c00ff4f, 0x1b50ff51, 0x1b50ff53, 0x1aa4ff55, 0x1aa4ff57, 0x19fcff59,
    0x19fcff5b, 0x1958ff5d, 0x1958ff5f, 0x18b9ff61, 0x18b9ff63, 0x181dff65, 0x181dff67, 0x1785ff69,
    0x1785ff6b, 0x16f1ff6d, 0x16f1ff6f, 0x1660ff70, 0x1660ff72, 0x15d3ff74, 0x15d3ff76, 0x154aff77,
    0x154aff79, 0x14c4ff7b, 0x14c4ff7c, 0x1441ff7e, 0x1441ff80, 0x13c1ff81, 0x13c1ff83, 0x1345ff84,
    0x1345ff86, 0x12ccff87, 0x12ccff89, 0x1255ff8a, 0x1255ff8c, 0x11e2ff8d, 0x11e2ff8f, 0x1171ff90,
    0x1171ff91, 0x1103ff93, 0x1103ff94, 0x1098ff95, 0x1098ff97, 0x102fff98, 0x102fff99, 0x0fc9ff9b,
    0x0fc9ff9c, 0x0f66ff9d, 0x0f66ff9e, 0x0f05ffa0, 0x0f05ffa1, 0x0ea6ffa2, 0x0ea6ffa3, 0x0e4affa4,
    0x0e4affa5, 0x0df0ffa7, 0x0df0ffa8, 0x0d98ffa9, 0x0d98ffaa, 0x0d43ffab, 0x0d43ffac, 0x0cefffad,
    0x0cefffae, 0x0c9effaf, 0x0c9effb0, 0x0c4effb1, 0x0c4effb2, 0x0c01ffb3, 0x0c01ffb4, 0x0bb5ffb5,
    0x0bb5ffb6, 0x0b6bffb7, 0x0b6bffb8, 0x0b23ffb9, 0x0b23ffb9, 0x0addffba, 0x0addffbb, 0x0a99ffbc,
    0x0a99ffbd, 0x0a56ffbe, 0x0a56ffbe, 0x0a15ffbf, 0x0a15ffc0, 0x09d5ffc1, 0x09d5ffc2, 0x0997ffc2,
    0x0997ffc3, 0x095bffc4, 0x095bffc5, 0x0920ffc5, 0x0920ffc6, 0x08e6ffc7, 0x08e6ffc8, 0x08aeffc8,
    0x08aeffc9, 0x0878ffca, 0x0878ffca, 0x0842ffcb, 0x0842ffcc, 0x080effcc, 0x080effcd, 0x07dcffce,
    0x07dcffce, 0x07aaffcf, 0x07aaffcf, 0x077affd0, 0x077affd1, 0x074bffd1, 0x074bffd2, 0x071dffd2,
    0x071dffd3, 0x06f0ffd3, 0x06f0ffd4, 0x06c4ffd5, 0x06c4ffd5, 0x069affd6, 0x069affd6, 0x0670ffd7,
    0x0670ffd7, 0x0647ffd8, 0x0647ffd8, 0x0620ffd9, 0x0620ffd9, 0x05f9ffda, 0x05f9ffda, 0x05d4ffdb,
    0x05d4ffdb, 0x05afffdc, 0x05afffdc, 0x058bffdc, 0x058bffdd, 0x0568ffdd, 0x0568ffde, 0x0546ffde,
    0x0546ffdf, 0x0525ffdf, 0x0525ffdf, 0x0504ffe0, 0x0504ffe0, 0x04e5ffe1, 0x04e5ffe1, 0x04c6ffe1,
    0x04c6ffe2, 0x04a8ffe2, 0x04a8ffe2, 0x048bffe3, 0x048bffe3, 0x046effe4, 0x046effe4, 0x0452ffe4,
    0x0452ffe5, 0x0437ffe5, 0x0437ffe5, 0x041cffe6, 0x041cffe6, 0x0402ffe6, 0x0402ffe7, 0x03e9ffe7,
    0x03e9ffe7, 0x03d0ffe8, 0x03d0ffe8, 0x03b8ffe8, 0x03b8ffe8, 0x03a1ffe9, 0x03a1ffe9, 0x038affe9,
    0x038affea, 0x0374ffea, 0x0374ffea, 0x035effea, 0x035effeb, 0x0349ffeb, 0x0349ffeb, 0x0334ffeb,
    0x0334ffec, 0x0320ffec, 0x0320ffec, 0x030cffec, 0x030cffed, 0x02f9ffed, 0x02f9ffed, 0x02e6ffed,
    0x02e6ffee, 0x02d4ffee, 0x02d4ffee, 0x02c2ffee, 0x02c2ffef, 0x02b1ffef, 0x02b1ffef, 0x02a0ffef,
    0x02a0ffef, 0x028ffff0, 0x028ffff0, 0x027ffff0, 0x027ffff0, 0x026ffff0, 0x026ffff1, 0x0260fff1,
    0x0260fff1, 0x0251fff1, 0x0251fff1, 0x0242fff1, 0x0242fff2, 0x0234fff2, 0x0234fff2, 0x0226fff2,
    0x0226fff2, 0x0219fff3, 0x0219fff3, 0x020cfff3, 0x020cfff3, 0x01fffff3, 0x01fffff3, 0x01f2fff4,
    0x01f2fff4, 0x01e6fff4, 0x01e6fff4, 0x01dafff4, 0x01dafff4, 0x01cefff4, 0x01cefff5, 0x01c3fff5,
    0x01c3fff5, 0x01b8fff5, 0x01b8fff5, 0x01adfff5, 0x01adfff5, 0x01a2fff6, 0x01a2fff6, 0x0198fff6,
    0x0198fff6, 0x018efff6, 0x018efff6, 0x0184fff6, 0x0184fff6, 0x017bfff6, 0x017bfff7, 0x0171fff7,
    0x0171fff7, 0x0168fff7, 0x0168fff7, 0x015ffff7, 0x015ffff7, 0x0157fff7, 0x0157fff8, 0x014efff8,
    0x014efff8, 0x0146fff8, 0x0146fff8, 0x013efff8, 0x013efff8, 0x0136fff8, 0x0136fff8, 0x012efff8,
    0x012efff8, 0x0127fff9, 0x0127fff9, 0x0120fff9, 0x0120fff9, 0x0119fff9, 0x0119fff9, 0x0112fff9,
    0x0112fff9, 0x010bfff9, 0x010bfff9, 0x0104fff9, 0x0104fffa, 0x00fefffa, 0x00fefffa, 0x00f8fffa,
    0x00f8fffa, 0x00f2fffa, 0x00f2fffa, 0x00ecfffa, 0x00ecfffa, 0x00e6fffa, 0x00e6fffa, 0x00e0fffa,
    0x00e0fffa, 0x00dbfffb, 0x00dbfffb, 0x00d5fffb, 0x00d5fffb, 0x00d0fffb, 0x00d0fffb, 0x00cbfffb,
    0x00cbfffb, 0x00c6fffb, 0x00c6fffb, 0x00c1fffb, 0x00c1fffb, 0x00bcfffb, 0x00bcfffb, 0x00b8fffb,
    0x00b8fffb, 0x00b3fffb, 0x00b3fffc, 0x00affffc, 0x00affffc, 0x00aafffc, 0x00aafffc, 0x00a6fffc,
    0x00a6fffc, 0x00a2fffc, 0x00a2fffc, 0x009efffc, 0x009efffc, 0x009afffc, 0x009afffc, 0x0096fffc,
    0x0096fffc, 0x0093fffc, 0x0093fffc, 0x008ffffc, 0x008ffffc, 0x008bfffc, 0x008bfffd, 0x0088fffd,
    0x0088fffd, 0x0085fffd, 0x0085fffd, 0x0081fffd, 0x0081fffd, 0x007efffd, 0x007efffd, 0x007bfffd,
    0x007bfffd, 0x0078fffd, 0x0078fffd, 0x0075fffd, 0x0075fffd, 0x0072fffd, 0x0072fffd, 0x006ffffd,
    0x006ffffd, 0x006dfffd, 0x006dfffd, 0x006afffd, 0x006afffd, 0x0067fffd, 0x0067fffd, 0x0065fffd,
    0x0065fffd, 0x0062fffe, 0x0062fffe, 0x0060fffe, 0x0060fffe, 0x005dfffe, 0x005dfffe, 0x005bfffe,
    0x005bfffe, 0x0059fffe, 0x0059fffe, 0x0057fffe, 0x0057fffe, 0x0055fffe, 0x0055fffe, 0x0052fffe,
    0x0052fffe, 0x0050fffe, 0x0050fffe, 0x004efffe, 0x004efffe, 0x004cfffe, 0x004cfffe, 0x004bfffe,
    0x004bfffe, 0x0049fffe, 0x0049fffe, 0x0047fffe, 0x0047fffe, 0x0045fffe, 0x0045fffe, 0x0043fffe,
    0x0043fffe, 0x0042fffe, 0x0042fffe, 0x0040fffe, 0x0040fffe, 0x003ffffe, 0x003ffffe, 0x003dfffe,
    0x003dfffe, 0x003bfffe, 0x003bffff, 0x003affff, 0x003affff, 0x0039ffff, 0x0039ffff, 0x0037ffff,
];

static SENSORS: [SensorTable; 4] = [
    // Sensor 0.
    SensorTable {
        number: 0,
        scale: [
            AxisScale { offset: -1462, gain: 294652 },
            AxisScale { offset: 149491, gain: 269410 },
            AxisScale { offset: 1101, gain: 498018 },
        ],
        limit_counts: 15999,
        linear: Linear {
            bias: [-793, 1260],
            slope: [[1822917, 1017, -259], [-420, -2504, 1834397]],
        },
        pairs: padded([
            CentrePair { xy: [[-9559, -1432], [-5883, 128]], z: [-9329, -9537], weight: [[-902, 2695], [-1923, 2925]] },
            CentrePair { xy: [[-1997, 939], [1963, 984]], z: [-9641, -9642], weight: [[-2058, 2083], [-182, -118]] },
            CentrePair { xy: [[5863, 263], [9570, -1208]], z: [-9541, -9336], weight: [[-2547, 828], [2872, -1838]] },
            CentrePair { xy: [[-9626, -987], [-5924, 580]], z: [-5627, -5747], weight: [[236, 23], [1260, -1451]] },
            CentrePair { xy: [[-2013, 1393], [1971, 1438]], z: [-5806, -5806], weight: [[-2214, 2140], [-1319, -1283]] },
            CentrePair { xy: [[5897, 715], [9630, -762]], z: [-5748, -5630], weight: [[-31, -217], [-1513, 1204]] },
            CentrePair { xy: [[-9654, -792], [-5941, 776]], z: [-1870, -1902], weight: [[79, 628], [2, -520]] },
            CentrePair { xy: [[-2020, 1591], [1974, 1636]], z: [-1917, -1917], weight: [[544, -497], [2765, 2810]] },
            CentrePair { xy: [[5910, 911], [9654, -568]], z: [-1901, -1869], weight: [[-613, -78], [-461, 53]] },
            CentrePair { xy: [[-9641, -851], [-5933, 716]], z: [1897, 1954], weight: [[-330, 258], [35, 661]] },
            CentrePair { xy: [[-2017, 1530], [1972, 1575]], z: [1982, 1983], weight: [[200, -140], [-2873, -2910]] },
            CentrePair { xy: [[5904, 851], [9642, -627]], z: [1957, 1902], weight: [[-226, 336], [596, -13]] },
            CentrePair { xy: [[-9590, -1160], [-5902, 401]], z: [5631, 5776], weight: [[581, 483], [-1614, 1403]] },
            CentrePair { xy: [[-2005, 1213], [1965, 1258]], z: [5848, 5850], weight: [[-2480, 2396], [1342, 1314]] },
            CentrePair { xy: [[5877, 536], [9595, -937]], z: [5781, 5641], weight: [[-504, -567], [1462, -1559]] },
            CentrePair { xy: [[-9498, -1719], [-5846, -167]], z: [9288, 9522], weight: [[-1384, 2984], [2203, -3056]] },
            CentrePair { xy: [[-1984, 640], [1952, 685]], z: [9639, 9641], weight: [[-2440, 2470], [202, 161]] },
            CentrePair { xy: [[5830, -32], [9513, -1496]], z: [9530, 9302], weight: [[-2832, 1316], [-3021, 2130]] },
        ]),
        used_pairs: 18,
        shift: [11, 11],
        parity: Parity {
            axis: 1,
            // Powers from the highest down, as `parity.rs` reads them.
            terms: [-7608, 43, 1369, -8139, -1738, -60449, 31, 996, 112, 6723, -2817, -1184, -42351, -8624, -1616997, 5, 180, 40, 2331, 552, 82832, -304, -191, -7563, -3095, -566118, -121775, 39976325],
            sigma: 96844,
        },
    },
    // Sensor 1.
    SensorTable {
        number: 1,
        scale: [
            AxisScale { offset: 1311, gain: 278992 },
            AxisScale { offset: 161299, gain: 264172 },
            AxisScale { offset: -243, gain: 417567 },
        ],
        limit_counts: 15999,
        linear: Linear {
            bias: [2033, -700],
            slope: [[1817936, -3016, -379], [-484, 1127, 1826094]],
        },
        pairs: padded([
            CentrePair { xy: [[-9506, -1210], [-5775, 156]], z: [-9403, -9579], weight: [[-1297, 2413], [-1542, 2395]] },
            CentrePair { xy: [[-1889, 770], [2031, 624]], z: [-9652, -9624], weight: [[-2261, 2154], [79, -664]] },
            CentrePair { xy: [[5865, -275], [9492, -1911]], z: [-9497, -9266], weight: [[-2933, 1426], [2955, -2562]] },
            CentrePair { xy: [[-9596, -532], [-5826, 841]], z: [-5704, -5811], weight: [[838, 326], [1349, -1561]] },
            CentrePair { xy: [[-1903, 1457], [2053, 1310]], z: [-5855, -5839], weight: [[-2051, 2344], [-691, -1094]] },
            CentrePair { xy: [[5925, 406], [9591, -1241]], z: [-5761, -5621], weight: [[-258, -689], [-703, 2099]] },
            CentrePair { xy: [[-9645, -176], [-5854, 1201]], z: [-1922, -1961], weight: [[-332, 84], [29, -576]] },
            CentrePair { xy: [[-1911, 1818], [2065, 1671]], z: [-1977, -1971], weight: [[377, -535], [2603, 2022]] },
            CentrePair { xy: [[5957, 763], [9644, -889]], z: [-1943, -1892], weight: [[-225, 262], [-1437, -725]] },
            CentrePair { xy: [[-9652, -144], [-5858, 1233]], z: [1894, 1922], weight: [[-53, 312], [-55, 492]] },
            CentrePair { xy: [[-1912, 1851], [2067, 1704]], z: [1933, 1928], weight: [[574, -737], [-2547, -1959]] },
            CentrePair { xy: [[5962, 795], [9652, -858]], z: [1908, 1870], weight: [[-432, 42], [1335, 710]] },
            CentrePair { xy: [[-9618, -439], [-5839, 937]], z: [5692, 5787], weight: [[605, 46], [-1140, 1618]] },
            CentrePair { xy: [[-1906, 1555], [2059, 1408]], z: [5826, 5810], weight: [[-1886, 2177], [657, 1112]] },
            CentrePair { xy: [[5940, 501], [9615, -1150]], z: [5741, 5614], weight: [[10, -500], [746, -1888]] },
            CentrePair { xy: [[-9542, -1058], [-5796, 314]], z: [9419, 9584], weight: [[-991, 2243], [1377, -2337]] },
            CentrePair { xy: [[-1894, 930], [2041, 785]], z: [9652, 9626], weight: [[-2034, 1934], [-100, 655]] },
            CentrePair { xy: [[5890, -119], [9532, -1763]], z: [9506, 9288], weight: [[-2765, 1146], [-2916, 2414]] },
        ]),
        used_pairs: 18,
        shift: [11, 11],
        parity: Parity {
            axis: 1,
            // Powers from the highest down, as `parity.rs` reads them.
            terms: [-6865, 48, -3411, -9348, 824, -57880, 43, -3164, 146, -18080, -4107, 712, -51426, 4327, -1645830, 8, -726, 67, -7961, 666, -276223, -566, 147, -11655, 1974, -733935, 66410, 43224184],
            sigma: 96699,
        },
    },
    // Sensor 2.
    SensorTable {
        number: 2,
        scale: [
            AxisScale { offset: -3569, gain: 250269 },
            AxisScale { offset: 152555, gain: 250176 },
            AxisScale { offset: 2821, gain: 417165 },
        ],
        limit_counts: 15999,
        linear: Linear {
            bias: [-4346, 3541],
            slope: [[1850771, 8212, -1071], [-3298, -4145, 1865188]],
        },
        pairs: padded([
            CentrePair { xy: [[-9511, -2042], [-5976, 90]], z: [-9175, -9458], weight: [[-1055, 3481], [-1536, 1947]] },
            CentrePair { xy: [[-2129, 1305], [1854, 1567]], z: [-9615, -9653], weight: [[-2233, 2510], [-389, 263]] },
            CentrePair { xy: [[5800, 868], [9537, -777]], z: [-9571, -9367], weight: [[-2654, 916], [1470, -703]] },
            CentrePair { xy: [[-9609, -1490], [-6037, 655]], z: [-5562, -5714], weight: [[212, -219], [1062, -688]] },
            CentrePair { xy: [[-2154, 1876], [1862, 2140]], z: [-5799, -5820], weight: [[-2502, 2035], [-894, -639]] },
            CentrePair { xy: [[5844, 1438], [9616, -215]], z: [-5778, -5670], weight: [[-28, -411], [-1287, 451]] },
            CentrePair { xy: [[-9652, -1251], [-6064, 899]], z: [-1877, -1900], weight: [[222, 521], [-162, -616]] },
            CentrePair { xy: [[-2165, 2123], [1866, 2388]], z: [-1914, -1918], weight: [[1120, -813], [1543, 1923]] },
            CentrePair { xy: [[5863, 1685], [9652, 28]], z: [-1914, -1901], weight: [[-281, -151], [62, 389]] },
            CentrePair { xy: [[-9640, -1328], [-6056, 820]], z: [1823, 1929], weight: [[-37, 188], [159, 673]] },
            CentrePair { xy: [[-2162, 2044], [1866, 2308]], z: [1986, 1997], weight: [[880, -584], [-1650, -2006]] },
            CentrePair { xy: [[5859, 1606], [9644, -51]], z: [1964, 1883], weight: [[79, 228], [-44, -348]] },
            CentrePair { xy: [[-9574, -1721], [-6015, 419]], z: [5481, 5715], weight: [[476, 123], [-1241, 705]] },
            CentrePair { xy: [[-2144, 1639], [1862, 1902]], z: [5844, 5872], weight: [[-2691, 2225], [925, 769]] },
            CentrePair { xy: [[5832, 1201], [9592, -450]], z: [5800, 5624], weight: [[-397, -754], [1272, -653]] },
            CentrePair { xy: [[-9452, -2423], [-5939, -301]], z: [9037, 9403], weight: [[-1455, 3735], [1679, -2076]] },
            CentrePair { xy: [[-2111, 911], [1853, 1172]], z: [9606, 9651], weight: [[-2551, 2840], [320, -245]] },
            CentrePair { xy: [[5780, 474], [9496, -1166]], z: [9539, 9265], weight: [[-2904, 1353], [-1685, 923]] },
        ]),
        used_pairs: 18,
        shift: [11, 10],
        parity: Parity {
            axis: 1,
            // Powers from the highest down, as `parity.rs` reads them.
            terms: [-19272, 655, 13760, -21005, -5048, -97569, 451, 10372, 935, 42628, -7315, -3448, -69952, -15476, -2145149, 63, 1926, 389, 15016, 4091, 497132, -770, -544, -13049, -5839, -770129, -171047, 41616653],
            sigma: 97120,
        },
    },
    // Sensor 3.
    SensorTable {
        number: 3,
        scale: [
            AxisScale { offset: 1321, gain: 292219 },
            AxisScale { offset: 153026, gain: 268535 },
            AxisScale { offset: 3510, gain: 471794 },
        ],
        limit_counts: 15999,
        linear: Linear {
            bias: [408, 3914],
            slope: [[1819896, -522, 482], [-316, -3962, 1830352]],
        },
        pairs: padded([
            CentrePair { xy: [[-9562, -1186], [-5862, 285]], z: [-9386, -9557], weight: [[-895, 2533], [-1857, 2678]] },
            CentrePair { xy: [[-1973, 1019], [1977, 1001]], z: [-9642, -9646], weight: [[-2024, 2030], [-289, -186]] },
            CentrePair { xy: [[5862, 229], [9553, -1282]], z: [-9566, -9400], weight: [[-2579, 942], [2605, -1719]] },
            CentrePair { xy: [[-9627, -734], [-5899, 743]], z: [-5671, -5757], weight: [[313, 1], [1318, -1290]] },
            CentrePair { xy: [[-1983, 1480], [1993, 1462]], z: [-5800, -5801], weight: [[-2108, 2101], [-1072, -1017]] },
            CentrePair { xy: [[5905, 687], [9624, -830]], z: [-5761, -5678], weight: [[9, -365], [-1423, 1218]] },
            CentrePair { xy: [[-9653, -555], [-5914, 925]], z: [-1903, -1905], weight: [[27, 593], [-167, -707]] },
            CentrePair { xy: [[-1987, 1663], [2000, 1645]], z: [-1906, -1906], weight: [[561, -565], [2442, 2538]] },
            CentrePair { xy: [[5923, 870], [9653, -650]], z: [-1905, -1903], weight: [[-581, -25], [-572, -63]] },
            CentrePair { xy: [[-9643, -649], [-5908, 829]], z: [1871, 1953], weight: [[-339, 179], [191, 842]] },
            CentrePair { xy: [[-1986, 1567], [1997, 1549]], z: [1995, 1997], weight: [[205, -229], [-2672, -2776]] },
            CentrePair { xy: [[5916, 774], [9641, -745]], z: [1958, 1879], weight: [[-193, 353], [708, 83]] },
            CentrePair { xy: [[-9595, -1017], [-5881, 457]], z: [5606, 5773], weight: [[644, 488], [-1735, 1223]] },
            CentrePair { xy: [[-1979, 1192], [1984, 1174]], z: [5858, 5861], weight: [[-2388, 2397], [1283, 1222]] },
            CentrePair { xy: [[5883, 401], [9588, -1113]], z: [5783, 5621], weight: [[-464, -698], [1368, -1633]] },
            CentrePair { xy: [[-9509, -1654], [-5833, -190]], z: [9255, 9509], weight: [[-1385, 2823], [2268, -3062]] },
            CentrePair { xy: [[-1966, 541], [1962, 523]], z: [9636, 9641], weight: [[-2393, 2389], [240, 130]] },
            CentrePair { xy: [[5825, -246], [9492, -1751]], z: [9522, 9277], weight: [[-2867, 1425], [-2987, 2123]] },
        ]),
        used_pairs: 18,
        shift: [11, 11],
        parity: Parity {
            axis: 1,
            // Powers from the highest down, as `parity.rs` reads them.
            terms: [-6968, -35, -644, -8233, -2770, -57874, -27, -518, -86, -3297, -3142, -2073, -44544, -14235, -1600068, -5, -103, -33, -1254, -422, -34635, -374, -368, -8740, -5603, -614609, -194421, 40910875],
            sigma: 96408,
        },
    },
];

/// No recurrent networks.
pub static NETWORKS: [Network<1, 4, 1>; 0] = [];

/// Calibration with networks of this size.
pub type TablesCalibration<'m> = crate::model::calibration::Calibration<'m, 1, 4, 1>;

/// Origin of tables and networks, as TOML.
pub static DESCRIPTION: &str = "";
