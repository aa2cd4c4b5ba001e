// zloam-registration: extracts the feature clouds of each sweep. The work is done in
// registration.hpp (the method), sharing.hpp (replicas) and registration_stage.hpp (keys).

#include <memory>

#include "registration/registration_parameters.hpp"
#include "registration/registration_stage.hpp"

int main(int argc, char** argv) {
  using namespace zloam;
  registration::RegistrationConfig config;
  registration::SharingConfig sharing;
  std::unique_ptr<registration::RegistrationStage> registration;
  return runtime::run_stage(argc, argv,
                            {.name = "registration",
                             .summary = "extracts edge and plane features from each sweep (LOAM)",
                             .bind =
                                 [&](runtime::Parameters& p) {
                                   bind(p, config);
                                   bind(p, sharing);
                                 },
                             .wire =
                                 [&](runtime::Stage& stage) {
                                   registration = std::make_unique<registration::RegistrationStage>(
                                       stage, config, sharing);
                                 }});
}
