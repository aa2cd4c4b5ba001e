#pragma once
// Handmade calibration files of an HDL-64E, for tests.

#include <string>

namespace zloam::driver::velodyne::test {

/// Values of laser 0 from the published vector S1; the others point 0.4 degrees lower each.
inline std::string calibration_yaml(int lasers = 64) {
  std::string text = "num_lasers: 64\ndistance_resolution: 0.002\nlasers:\n";
  for (int i = 0; i < lasers; ++i) {
    text += "- {laser_id: " + std::to_string(i) + ", rot_correction: -0.0764824746" +
            ", vert_correction: " + std::to_string(-0.1261818455 - 0.007 * i) +
            ", dist_correction: 1.413949, dist_correction_x: 1.4198447" +
            ", dist_correction_y: 1.4058145, vert_offset_correction: 0.21569468" +
            ", horiz_offset_correction: 0.026, focal_distance: 10.5, focal_slope: 1.85" +
            ", min_intensity: 5, max_intensity: 255.0, two_pt_correction_available: true}\n";
  }
  return text;
}

/// The same in the maker's units: degrees and centimetres.
inline std::string calibration_xml(int lasers = 64) {
  std::string points, enabled, least, greatest;
  for (int i = 0; i < lasers; ++i) {
    const double elevation_deg = (-0.1261818455 - 0.007 * i) * 57.29577951308232;
    points += "<item><px><id_>" + std::to_string(i) + "</id_><rotCorrection_>" +
              std::to_string(-0.0764824746 * 57.29577951308232) + "</rotCorrection_>" +
              "<vertCorrection_>" + std::to_string(elevation_deg) + "</vertCorrection_>" +
              "<distCorrection_>141.3949</distCorrection_>" +
              "<distCorrectionX_>141.98447</distCorrectionX_>" +
              "<distCorrectionY_>140.58145</distCorrectionY_>" +
              "<vertOffsetCorrection_>21.569468</vertOffsetCorrection_>" +
              "<horizOffsetCorrection_>2.6</horizOffsetCorrection_>" +
              "<focalDistance_>1050</focalDistance_><focalSlope_>1.85</focalSlope_></px></item>";
    enabled += "<item>" + std::string(i == 7 ? "0" : "1") + "</item>";
    least += "<item>5</item>";
    greatest += "<item>255</item>";
  }
  return "<?xml version=\"1.0\"?>\n<!DOCTYPE boost_serialization>\n"
         "<boost_serialization signature=\"serialization::archive\"><DB><distLSB_>0.2</distLSB_>"
         "<enabled_><count>64</count>" +
         enabled + "</enabled_><minIntensity_>" + least + "</minIntensity_><maxIntensity_>" +
         greatest + "</maxIntensity_><points_><count>64</count>" + points +
         "</points_></DB></boost_serialization>\n";
}

}  // namespace zloam::driver::velodyne::test
