// zloam-aloam-registration: A-LOAM's scan registration in place of registration. The method is in
// core/scan_registration.hpp.

#include <memory>

#include "aloam/registration/registration_stage.hpp"

int main(int argc, char** argv) {
  using namespace zloam;
  aloam::AloamConfig config;
  std::unique_ptr<aloam::RegistrationStage> registration;
  return runtime::run_stage(argc, argv,
                            {.name = "registration",
                             .variant = aloam::kVariant,
                             .summary = "extracts feature points from each sweep, as A-LOAM does",
                             .bind = [&](runtime::Parameters& p) { bind(p, config); },
                             .wire =
                                 [&](runtime::Stage& stage) {
                                   registration = std::make_unique<aloam::RegistrationStage>(stage);
                                 }});
}
