/// VTK's own files, legacy and XML.
#include <algorithm>
#include <cmath>

#include <vtkDataReader.h>
#include <vtkFieldData.h>
#include <vtkGenericDataObjectReader.h>
#include <vtkInformation.h>
#include <vtkNew.h>
#include <vtkStreamingDemandDrivenPipeline.h>
#include <vtkXMLGenericDataObjectReader.h>

#include "engine/error.h"
#include "scenes/import/reader.h"
#include "scenes/import/vtk_run.h"

namespace palpate::importer {
namespace {

class LegacyReader final : public Reader {
 public:
  explicit LegacyReader(Request request) : request_(std::move(request)) {}

  Content read(std::size_t /*step*/) override {
    vtkNew<vtkGenericDataObjectReader> reader;
    reader->SetFileName(request_.file.c_str());
    reader->ReadAllScalarsOn();
    reader->ReadAllVectorsOn();
    reader->ReadAllNormalsOn();
    reader->ReadAllTensorsOn();
    reader->ReadAllFieldsOn();
    run(reader, request_.file.string(), request_.progress);
    Content content;
    content.data = reader->GetOutput();
    if (reader->GetHeader() != nullptr) content.description = reader->GetHeader();
    return content;
  }

 private:
  Request request_;
};

class XmlReader final : public Reader {
 public:
  explicit XmlReader(Request request) : request_(std::move(request)) {}

  Content read(std::size_t /*step*/) override {
    vtkNew<vtkXMLGenericDataObjectReader> reader;
    reader->SetFileName(request_.file.c_str());
    run(reader, request_.file.string(), request_.progress);
    Content content;
    content.data = reader->GetOutput();
    return content;
  }

 private:
  Request request_;
};

}  // namespace

std::unique_ptr<Reader> openVtkLegacy(const Request& request) {
  return std::make_unique<LegacyReader>(request);
}

std::unique_ptr<Reader> openVtkXml(const Request& request) {
  return std::make_unique<XmlReader>(request);
}

}  // namespace palpate::importer
